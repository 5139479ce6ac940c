// Addresses of hosts as numbers, and as getaddrinfo takes them.

#pragma once

#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <string>

#include <absl/strings/string_view.h>
#include <absl/strings/strip.h>

namespace craftfleet {

// "10.0.0.7" or "fe80::1%eth0", of an IPv4 or IPv6 address; "": another kind. Thread-safe.
inline std::string NumericHost(const sockaddr* address) {
  const socklen_t size = address->sa_family == AF_INET6 ? sizeof(sockaddr_in6) : sizeof(sockaddr_in);
  char host[NI_MAXHOST];
  return getnameinfo(address, size, host, sizeof(host), nullptr, 0, NI_NUMERICHOST) == 0 ? host : "";
}

// "::1" of "[::1]"; other hosts as they are.
inline std::string WithoutBrackets(absl::string_view host) {
  if (absl::ConsumePrefix(&host, "[")) absl::ConsumeSuffix(&host, "]");
  return std::string(host);
}

}  // namespace craftfleet
