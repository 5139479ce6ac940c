// A network connection between two processes that a test can break.

#ifndef CRAFTFLEET_TESTS_FAKES_TCP_FORWARDER_H_
#define CRAFTFLEET_TESTS_FAKES_TCP_FORWARDER_H_

#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <string>
#include <thread>
#include <vector>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

#include "common/base/check.h"

namespace craftfleet {

// Listens on a free port on loopback and forwards the bytes of each connection to and from `target`, "127.0.0.1:PORT".
// After Freeze it forwards nothing and keeps every connection open, like a host that lost its network: sent data
// vanishes. Freeze and Thaw are thread-safe.
class TcpForwarder {
 public:
  explicit TcpForwarder(absl::string_view target) {
    CRAFTFLEET_CHECK(absl::SimpleAtoi(target.substr(target.rfind(':') + 1), &target_port_));
    listener_ = socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in name = Loopback(0);
    socklen_t size = sizeof(name);
    CRAFTFLEET_CHECK(bind(listener_, reinterpret_cast<sockaddr*>(&name), size) == 0 && listen(listener_, 16) == 0);
    CRAFTFLEET_CHECK(getsockname(listener_, reinterpret_cast<sockaddr*>(&name), &size) == 0);
    address_ = absl::StrCat("127.0.0.1:", ntohs(name.sin_port));
    thread_ = std::thread([this] { Run(); });
  }
  ~TcpForwarder() {
    ended_ = true;
    thread_.join();
    close(listener_);
    for (const int end : ends_) close(end);
  }
  TcpForwarder(const TcpForwarder&) = delete;
  TcpForwarder& operator=(const TcpForwarder&) = delete;

  const std::string& address() const { return address_; }
  void Freeze() { frozen_ = true; }
  void Thaw() { frozen_ = false; }

 private:
  static sockaddr_in Loopback(int port) {
    sockaddr_in name = {};
    name.sin_family = AF_INET;
    name.sin_port = htons(static_cast<uint16_t>(port));
    name.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    return name;
  }

  void Run() {
    while (!ended_) {
      std::vector<pollfd> wanted;
      if (!frozen_) wanted.push_back({listener_, POLLIN, 0});
      for (size_t i = 0; i < ends_.size() && !frozen_; ++i) wanted.push_back({ends_[i], POLLIN, 0});
      poll(wanted.data(), wanted.size(), /*timeout_ms=*/10);
      for (size_t i = 1; i < wanted.size(); ++i) {
        if (wanted[i].revents != 0 && !frozen_) Carry(i - 1);
      }
      if (!wanted.empty() && wanted[0].revents != 0 && !frozen_) Accept();
    }
  }
  void Accept() {
    const int client = accept(listener_, nullptr, nullptr);
    const int server = socket(AF_INET, SOCK_STREAM, 0);
    const sockaddr_in name = Loopback(target_port_);
    if (connect(server, reinterpret_cast<const sockaddr*>(&name), sizeof(name)) != 0) {
      close(client);
      close(server);
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

  int target_port_ = 0;
  int listener_ = -1;
  std::string address_;
  std::vector<int> ends_;  // client's, server's, client's, ...; -1: closed
  std::atomic<bool> frozen_{false};
  std::atomic<bool> ended_{false};
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_FAKES_TCP_FORWARDER_H_
