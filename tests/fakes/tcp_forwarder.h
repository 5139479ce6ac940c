// A network connection between two processes that a test can break.

#pragma once

#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "tests/fakes/loopback.h"

namespace craftfleet {

// Listens on a free port on loopback and forwards the bytes of each connection to and from `target`, "127.0.0.1:PORT".
// After Freeze it forwards nothing and keeps every connection open, like a host that lost its network: sent data
// vanishes. Freeze and Thaw are thread-safe.
class TcpForwarder {
 public:
  explicit TcpForwarder(std::string target) : target_(std::move(target)), thread_([this] { Run(); }) {}
  ~TcpForwarder() {
    ended_ = true;
    thread_.join();
    for (const int end : ends_) close(end);
  }
  TcpForwarder(const TcpForwarder&) = delete;
  TcpForwarder& operator=(const TcpForwarder&) = delete;

  std::string address() const { return listener_.address(); }
  void Freeze() { frozen_ = true; }
  void Thaw() { frozen_ = false; }

 private:
  void Run() {
    while (!ended_) {
      std::vector<pollfd> wanted;
      if (!frozen_) wanted.push_back({listener_.descriptor(), POLLIN, 0});
      for (size_t i = 0; i < ends_.size() && !frozen_; ++i) wanted.push_back({ends_[i], POLLIN, 0});
      poll(wanted.data(), wanted.size(), /*timeout_ms=*/10);
      for (size_t i = 1; i < wanted.size(); ++i) {
        if (wanted[i].revents != 0 && !frozen_) Carry(i - 1);
      }
      if (!wanted.empty() && wanted[0].revents != 0 && !frozen_) Accept();
    }
  }
  void Accept() {
    const int client = accept(listener_.descriptor(), nullptr, nullptr);
    const int server = ConnectTo(target_);
    if (server < 0) {
      close(client);
      return;
    }
    ends_.push_back(client);
    ends_.push_back(server);
  }
  // Forwards received bytes to the other end of the connection; if one end is closed, closes both.
  void Carry(size_t from) {
    const size_t to = from ^ 1;
    char bytes[1 << 16];
    const ssize_t got = recv(ends_[from], bytes, sizeof(bytes), 0);
    ssize_t sent = 0;
    while (sent < got) {
      const ssize_t part = send(ends_[to], bytes + sent, got - sent, MSG_NOSIGNAL);
      if (part <= 0) break;
      sent += part;
    }
    if (got > 0 && sent == got) return;
    for (const size_t end : {from, to}) {
      if (ends_[end] >= 0) close(ends_[end]);
      ends_[end] = -1;
    }
  }

  const std::string target_;
  const LoopbackListener listener_;
  std::vector<int> ends_;  // client's, server's, client's, ...; -1: closed
  std::atomic<bool> frozen_{false};
  std::atomic<bool> ended_{false};
  std::thread thread_;
};

}  // namespace craftfleet
