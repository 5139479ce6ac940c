#include "common/wire/listen_socket.h"

#include <netdb.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <system_error>
#include <vector>

#include <absl/cleanup/cleanup.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/numeric_host.h"
#include "common/base/status_macros.h"
#include "common/telemetry/log.h"
#include "common/wire/channel.h"

namespace craftfleet::wire {
namespace {

bool IsLoopbackAddress(const addrinfo& entry) {
  if (entry.ai_family == AF_INET) {
    return ntohl(reinterpret_cast<const sockaddr_in*>(entry.ai_addr)->sin_addr.s_addr) >> 24 == 127;
  }
  return IN6_IS_ADDR_LOOPBACK(&reinterpret_cast<const sockaddr_in6*>(entry.ai_addr)->sin6_addr);
}

}  // namespace

absl::StatusOr<std::unique_ptr<ListenSocket>> ListenSocket::Create(const std::string& address) {
  const size_t colon = address.rfind(':');
  std::string host = address.substr(0, colon);
  std::unique_ptr<ListenSocket> socket(new ListenSocket);
  int error = 0;
  absl::Status bound = socket->Bind(address, &error);
  if (host == "[::]" && (error == EAFNOSUPPORT || error == EADDRNOTAVAIL)) {  // a host without IPv6
    host = "0.0.0.0";
    bound = socket->Bind(absl::StrCat(host, address.substr(colon)), &error);
  }
  CRAFTFLEET_RETURN_IF_ERROR(bound);
  sockaddr_in6 actual = {};  // a sockaddr_in has its port at the same place
  socklen_t size = sizeof(actual);
  getsockname(socket->descriptor_, reinterpret_cast<sockaddr*>(&actual), &size);
  const std::string numeric = NumericHost(reinterpret_cast<sockaddr*>(&actual));
  socket->numeric_host_ = actual.sin6_family == AF_INET6 ? absl::StrCat("[", numeric, "]") : numeric;
  socket->address_ = absl::StrCat(host, ":", ntohs(actual.sin6_port));
  return socket;
}

ListenSocket::~ListenSocket() {
  if (descriptor_ >= 0) close(descriptor_);
}

absl::Status ListenSocket::Bind(absl::string_view address, int* error) {
  const size_t colon = address.rfind(':');
  const std::string host = WithoutBrackets(address.substr(0, colon));
  addrinfo hints = {};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  if (const int unknown = getaddrinfo(host.c_str(), std::string(address.substr(colon + 1)).c_str(), &hints, &found);
      unknown != 0) {
    return absl::UnavailableError(
        absl::StrFormat("cannot listen on %s: %s; choose another address", address, gai_strerror(unknown)));
  }
  const absl::Cleanup free_found = [found] { freeaddrinfo(found); };
  std::vector<const addrinfo*> entries;
  for (const addrinfo* entry = found; entry != nullptr; entry = entry->ai_next) entries.push_back(entry);
  std::stable_partition(entries.begin(), entries.end(), [](const addrinfo* e) { return e->ai_family == AF_INET; });
  for (const addrinfo* entry : entries) {
    *error = BindTo(*entry);
    if (*error == 0 && IsLoopbackAddress(*entry) && !IsLoopback(address)) {
      LogWarning(
          "%s: on this host the name is an address of loopback (see /etc/hosts): other hosts cannot connect; listen "
          "on an address of the network, or on [::]",
          address);
    }
    if (*error == 0) return absl::OkStatus();
    if (*error == EADDRINUSE) break;
  }
  return absl::UnavailableError(absl::StrFormat(
      "cannot listen on %s: %s (%s)", address,
      *error == EADDRINUSE ? "the port is in use; choose another" : "the host is not this machine, or not allowed",
      std::generic_category().message(*error)));
}

int ListenSocket::BindTo(const addrinfo& entry) {
  descriptor_ = socket(entry.ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (descriptor_ < 0) return errno;
  const int on = 1;
  const int off = 0;
  setsockopt(descriptor_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof(on));
  if (entry.ai_family == AF_INET6) setsockopt(descriptor_, IPPROTO_IPV6, IPV6_V6ONLY, &off, sizeof(off));
  if (bind(descriptor_, entry.ai_addr, entry.ai_addrlen) == 0 && listen(descriptor_, SOMAXCONN) == 0) return 0;
  const int error = errno;
  close(descriptor_);
  descriptor_ = -1;
  return error;
}

}  // namespace craftfleet::wire
