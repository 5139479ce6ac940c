#include "common/wire/listener.h"

#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/epoll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <system_error>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/strip.h>
#include <absl/time/time.h>

#include "common/base/check.h"
#include "common/base/status_macros.h"
#include "common/telemetry/log.h"
#include "common/telemetry/process_usage.h"
#include "common/wire/channel.h"
#include "common/wire/handshake_log.h"

namespace craftfleet::wire {
namespace {

constexpr int kBacklog = 1024;
constexpr rlim_t kWantedDescriptors = 65536;
constexpr rlim_t kKeptDescriptors = 128;  // for files, libraries and outgoing connections
constexpr rlim_t kKeptForCalls = 8192;    // if the limit is large enough: two for each of 4096 calls
constexpr int kUserTimeoutMs = 4000;      // until unacknowledged data ends a connection; as keepalive's
constexpr int kPauseMs = 100;             // after running out of descriptors
constexpr int kMaxEvents = 64;            // per wait
constexpr int kInspectEveryMs = 25;       // a flood takes up to two gigabytes a second
constexpr absl::Duration kMaxHandOver = absl::Seconds(2);
// If the process grows by more, connections are inspected early.
constexpr int64_t kMemoryUninspected = int64_t{64} << 20;

void SetOption(int socket, int level, int option, int value) {
  setsockopt(socket, level, option, &value, sizeof(value));
}

// The client's address without its port.
std::string ClientOf(const sockaddr_storage& address, socklen_t size) {
  char host[NI_MAXHOST];
  if (getnameinfo(reinterpret_cast<const sockaddr*>(&address), size, host, sizeof(host), nullptr, 0, NI_NUMERICHOST) !=
      0) {
    return "?";
  }
  return std::string(absl::StripPrefix(host, "::ffff:"));  // of a client with IPv4 at a socket for both
}

bool IsLoopbackAddress(const addrinfo& address) {
  if (address.ai_family == AF_INET) {
    return ntohl(reinterpret_cast<const sockaddr_in*>(address.ai_addr)->sin_addr.s_addr) >> 24 == 127;
  }
  return IN6_IS_ADDR_LOOPBACK(&reinterpret_cast<const sockaddr_in6*>(address.ai_addr)->sin6_addr);
}

// The number of connections that the process can hold, at two descriptors each.
size_t MaxConnections() {
  rlimit limit = {};
  getrlimit(RLIMIT_NOFILE, &limit);
  if (limit.rlim_cur < kWantedDescriptors) {
    limit.rlim_cur = std::min(kWantedDescriptors, limit.rlim_max);
    setrlimit(RLIMIT_NOFILE, &limit);
    getrlimit(RLIMIT_NOFILE, &limit);
  }
  const rlim_t kept = kKeptDescriptors + (limit.rlim_cur >= kPlentyOfFiles ? kKeptForCalls : 0);
  return limit.rlim_cur > 2 * kept ? (limit.rlim_cur - kept) / 2 : 16;
}

// CPU time of the calling thread.
absl::Duration ThreadTime() {
  timespec time = {};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return absl::DurationFromTimespec(time);
}

}  // namespace

absl::StatusOr<std::unique_ptr<Listener>> Listener::Create(const Options& options) {
  std::unique_ptr<Listener> listener(new Listener(options));
  CRAFTFLEET_RETURN_IF_ERROR(listener->Bind());
  listener->max_connections_ = MaxConnections();
  if (options.max_connections > 0) {
    listener->max_connections_ = std::min(listener->max_connections_, static_cast<size_t>(options.max_connections));
  }
  return listener;
}

Listener::~Listener() { Stop(); }

absl::Status Listener::Bind() {
  const absl::string_view address = options_.address;
  const size_t colon = address.rfind(':');
  absl::string_view host = address.substr(0, colon);
  if (absl::ConsumePrefix(&host, "[")) absl::ConsumeSuffix(&host, "]");
  addrinfo hints = {};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_PASSIVE | AI_NUMERICSERV;
  addrinfo* found = nullptr;
  const std::string service(address.substr(colon + 1));
  if (const int error = getaddrinfo(std::string(host).c_str(), service.c_str(), &hints, &found); error != 0) {
    return absl::UnavailableError(
        absl::StrFormat("cannot listen on %s: %s; choose another address", address, gai_strerror(error)));
  }
  absl::Status status;
  bool only_here = true;
  for (const addrinfo* entry = found; entry != nullptr; entry = entry->ai_next) {
    status.Update(BindTo(*entry));
    only_here &= IsLoopbackAddress(*entry);
  }
  freeaddrinfo(found);
  if (sockets_.empty() && host == "::") return BindAllOfIpv4(service);
  if (!sockets_.empty() && only_here && !IsLoopback(address)) {
    LogWarning(
        "%s: on this host the name is an address of loopback (see /etc/hosts): other hosts cannot connect; listen "
        "on an address of the network, or on [::]",
        address);
  }
  address_ = absl::StrCat(address.substr(0, colon), ":", port_);
  // A name like localhost may have addresses of a family that this machine lacks.
  return sockets_.empty() ? status : absl::OkStatus();
}

absl::Status Listener::BindAllOfIpv4(const std::string& service) {
  sockaddr_in any = {};
  any.sin_family = AF_INET;
  any.sin_port = htons(static_cast<uint16_t>(std::stoi(service)));
  addrinfo entry = {};
  entry.ai_family = AF_INET;
  entry.ai_addr = reinterpret_cast<sockaddr*>(&any);
  entry.ai_addrlen = sizeof(any);
  CRAFTFLEET_RETURN_IF_ERROR(BindTo(entry));
  address_ = absl::StrCat("0.0.0.0:", port_);
  return absl::OkStatus();
}

absl::Status Listener::BindTo(const addrinfo& address) {
  const auto error = [this](const char* what) {
    const std::string reason = std::generic_category().message(errno);
    return absl::UnavailableError(absl::StrFormat(
        "cannot listen on %s: %s (%s: %s)", options_.address,
        errno == EADDRINUSE ? "the port is in use; choose another" : "the host is not this machine, or not allowed",
        what, reason));
  };
  const int socket = ::socket(address.ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (socket < 0) return error("socket");
  SetOption(socket, SOL_SOCKET, SO_REUSEADDR, 1);
  if (address.ai_family == AF_INET6) SetOption(socket, IPPROTO_IPV6, IPV6_V6ONLY, 0);  // [::] is IPv4 too
  // Accepted sockets inherit these options.
  SetOption(socket, IPPROTO_TCP, TCP_NODELAY, 1);
  SetOption(socket, IPPROTO_TCP, TCP_USER_TIMEOUT, kUserTimeoutMs);
  sockaddr_storage wanted = {};
  std::memcpy(&wanted, address.ai_addr, address.ai_addrlen);
  // The second address of a name uses the port assigned to the first.
  auto* port4 = &reinterpret_cast<sockaddr_in*>(&wanted)->sin_port;
  auto* port = address.ai_family == AF_INET6 ? &reinterpret_cast<sockaddr_in6*>(&wanted)->sin6_port : port4;
  if (*port == 0) *port = htons(static_cast<uint16_t>(port_));
  if (bind(socket, reinterpret_cast<sockaddr*>(&wanted), address.ai_addrlen) != 0 || listen(socket, kBacklog) != 0) {
    absl::Status status = error("bind");
    close(socket);
    return status;
  }
  socklen_t size = sizeof(wanted);
  getsockname(socket, reinterpret_cast<sockaddr*>(&wanted), &size);
  port_ = ntohs(*port);
  sockets_.push_back(socket);
  return absl::OkStatus();
}

void Listener::Start(std::vector<HandOver::Handle> handles, Inspect inspect) {
  hand_over_ = std::make_unique<HandOver>(std::move(handles));
  inspect_ = std::move(inspect);
  CRAFTFLEET_CHECK(pipe2(wake_up_, O_CLOEXEC) == 0);
  poll_ = epoll_create1(EPOLL_CLOEXEC);
  CRAFTFLEET_CHECK(poll_ >= 0);
  for (const int descriptor : sockets_) {
    epoll_event event = {EPOLLIN, {.fd = descriptor}};
    epoll_ctl(poll_, EPOLL_CTL_ADD, descriptor, &event);
  }
  epoll_event event = {EPOLLIN, {.fd = wake_up_[0]}};
  epoll_ctl(poll_, EPOLL_CTL_ADD, wake_up_[0], &event);
  thread_ = std::thread([this] { Run(); });
}

void Listener::Stop() {
  if (thread_.joinable()) {
    [[maybe_unused]] const ssize_t written = write(wake_up_[1], "e", 1);
    thread_.join();
    close(wake_up_[0]);
    close(wake_up_[1]);
    close(poll_);
    hand_over_.reset();
  }
  for (const int socket : sockets_) close(socket);
  sockets_.clear();
  for (const auto& [copy, client] : connections_) close(copy);
  connections_.clear();
}

void Listener::Run() {
  epoll_event events[kMaxEvents];
  while (true) {
    const bool inspects = inspect_ != nullptr && !connections_.empty();
    const int count = epoll_wait(poll_, events, kMaxEvents, inspects ? kInspectEveryMs : -1);
    // Closed connections are handled first, so that a client that replaces a connection is not refused.
    for (int i = 0; i < count; ++i) {
      if (events[i].data.fd == wake_up_[0]) return;
      Forget(events[i].data.fd);
    }
    for (int i = 0; i < count; ++i) {
      const int descriptor = events[i].data.fd;
      if (std::find(sockets_.begin(), sockets_.end(), descriptor) != sockets_.end()) Accept(descriptor);
    }
    if (inspects) {
      EndInspected();
      EndSlow();
    }
  }
}

void Listener::Accept(int socket) {
  sockaddr_storage address = {};
  socklen_t size = sizeof(address);
  const int descriptor = accept4(socket, reinterpret_cast<sockaddr*>(&address), &size, SOCK_NONBLOCK | SOCK_CLOEXEC);
  if (descriptor < 0) {
    if (errno != EMFILE && errno != ENFILE && errno != ENOBUFS && errno != ENOMEM) return;  // the client left
    log_.Warn("accept", absl::StrFormat("%s: a client has to wait: %s; raise the limit (ulimit -n)", address_,
                                        std::generic_category().message(errno)));
    poll(nullptr, 0, kPauseMs);
    return;
  }
  const std::string client = ClientOf(address, size);
  const auto known = per_client_.find(client);
  const int open = known == per_client_.end() ? 0 : known->second;
  if (connections_.size() >= max_connections_) {
    const bool by_files = max_connections_ != static_cast<size_t>(options_.max_connections);
    log_.Warn("all",
              absl::StrFormat("%s: refused a connection from %s: there are %d, all that %s allows", address_, client,
                              connections_.size(), by_files ? "the limit of open files (ulimit -n)" : options_.limit));
  } else if (open >= options_.max_connections_per_client) {
    log_.Warn(client, absl::StrFormat("%s: refused a connection from %s, which has %d, all that %s allows", address_,
                                      client, open, options_.limit));
  } else {
    Admit(descriptor, client);
    return;
  }
  close(descriptor);
}

void Listener::Admit(int descriptor, const std::string& client) {
  const int copy = fcntl(descriptor, F_DUPFD_CLOEXEC, 0);
  epoll_event event = {EPOLLRDHUP, {.fd = copy}};
  if (copy < 0 || epoll_ctl(poll_, EPOLL_CTL_ADD, copy, &event) != 0) {
    if (copy >= 0) close(copy);
    close(descriptor);
    return;
  }
  connections_[copy] = client;
  ++per_client_[client];
  NoteConnection(client);
  hand_over_->Add(descriptor);
}

// gRPC shuts a connection down before it closes it, which the copy reports too; so does a peer that disconnects.
void Listener::Forget(int copy) {
  const auto connection = connections_.find(copy);
  if (connection == connections_.end()) return;
  const auto count = per_client_.find(connection->second);
  if (--count->second == 0) per_client_.erase(count);
  connections_.erase(connection);
  // Closing a copy does not remove it from the epoll set while the server holds the original.
  epoll_ctl(poll_, EPOLL_CTL_DEL, copy, nullptr);
  close(copy);
}

void Listener::EndInspected() {
  if (clock_.Now() < next_inspection_ && ResidentMemoryBytes() <= inspected_memory_ + kMemoryUninspected) return;
  const absl::Duration begin = ThreadTime();
  const std::map<int, std::string> floods = inspect_(connections_);
  inspected_memory_ = ResidentMemoryBytes();
  // With very many connections less often, at the cost of some 2% of a core.
  const absl::Duration cost = ThreadTime() - begin;
  next_inspection_ = clock_.Now() + std::clamp(50 * cost, absl::Milliseconds(kInspectEveryMs), absl::Seconds(1));
  for (const auto& [copy, reason] : floods) {
    const std::string& client = connections_[copy];
    log_.Warn(client, absl::StrFormat("%s: ended a connection from %s: %s", address_, client, reason));
    ResetConnection(copy);  // the server closes it, and epoll reports it
  }
}

void Listener::EndSlow() {
  if (const int count = hand_over_->ResetSlow(kMaxHandOver); count > 0) {
    log_.Warn("slow", absl::StrFormat("%s: reset connections whose hand-over took longer than %s: %d", address_,
                                      absl::FormatDuration(kMaxHandOver), count));
  }
}

}  // namespace craftfleet::wire
