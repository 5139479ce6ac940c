// TCP sockets on loopback.

#pragma once

#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdint>
#include <string>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

#include "common/base/check.h"

namespace craftfleet {

// Port 0: any free one.
inline sockaddr_in Loopback(int port) {
  sockaddr_in name = {};
  name.sin_family = AF_INET;
  name.sin_port = htons(static_cast<uint16_t>(port));
  name.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return name;
}

// Listens on a free port, but does not answer by itself.
class LoopbackListener {
 public:
  LoopbackListener() : descriptor_(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in name = Loopback(0);
    socklen_t size = sizeof(name);
    CRAFTFLEET_CHECK(bind(descriptor_, reinterpret_cast<sockaddr*>(&name), size) == 0 && listen(descriptor_, 64) == 0);
    CRAFTFLEET_CHECK(getsockname(descriptor_, reinterpret_cast<sockaddr*>(&name), &size) == 0);
    port_ = ntohs(name.sin_port);
  }
  ~LoopbackListener() { close(descriptor_); }
  LoopbackListener(const LoopbackListener&) = delete;
  LoopbackListener& operator=(const LoopbackListener&) = delete;

  int descriptor() const { return descriptor_; }
  int port() const { return port_; }
  std::string address() const { return absl::StrCat("127.0.0.1:", port_); }

 private:
  const int descriptor_;
  int port_ = 0;
};

// A port that nobody listens on at the moment.
inline int FreePort() { return LoopbackListener().port(); }

// A connection to `address`, "127.0.0.1:PORT", for the caller to close; -1: refused.
inline int ConnectTo(absl::string_view address) {
  int port = 0;
  CRAFTFLEET_CHECK(absl::SimpleAtoi(address.substr(address.rfind(':') + 1), &port));
  const sockaddr_in name = Loopback(port);
  const int connection = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (connect(connection, reinterpret_cast<const sockaddr*>(&name), sizeof(name)) == 0) return connection;
  close(connection);
  return -1;
}

}  // namespace craftfleet
