// A TCP socket that listens.

#pragma once

#include <memory>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

struct addrinfo;

namespace craftfleet::wire {

// Closed with the object. Thread-compatible.
class ListenSocket {
 public:
  // Listens on HOST:PORT; port 0: any free one; [::]: every address of this host, with IPv4's. Of a name's addresses it
  // takes the first, IPv4 before IPv6. Warns of a name that other hosts don't reach, since it means loopback here.
  //   Unavailable: the port is in use, the host is unknown or not this machine.
  static absl::StatusOr<std::unique_ptr<ListenSocket>> Create(const std::string& address);
  ~ListenSocket();

  int descriptor() const { return descriptor_; }
  // HOST:PORT with the requested host and the actual port; 0.0.0.0 for [::] without IPv6.
  const std::string& address() const { return address_; }
  // The address of that host as a number, IPv6 in brackets.
  const std::string& numeric_host() const { return numeric_host_; }

 private:
  ListenSocket() = default;
  // `error`: becomes the errno of an address that cannot be bound.
  absl::Status Bind(absl::string_view address, int* error);
  // Returns 0 or an errno.
  int BindTo(const addrinfo& entry);

  std::string address_;
  std::string numeric_host_;
  int descriptor_ = -1;
};

}  // namespace craftfleet::wire
