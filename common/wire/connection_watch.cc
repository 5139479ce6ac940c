#include "common/wire/connection_watch.h"

#include <grpc/grpc.h>
#include <grpc/support/alloc.h>
#include <linux/sockios.h>
#include <linux/tcp.h>
#include <netinet/in.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include <algorithm>
#include <memory>
#include <utility>

#include <absl/strings/escaping.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"

namespace craftfleet::wire {
namespace {

using nlohmann::json;

constexpr intptr_t kMaxSockets = 1 << 17;     // in one answer
constexpr double kIdleBytesPerSecond = 4096;  // for pings and the updates of windows, which belong to no message

// A channelz answer, which this frees. Discarded: there is none.
json Parse(char* answer) {
  if (answer == nullptr) return json(json::value_t::discarded);
  const std::unique_ptr<char, void (*)(void*)> owned(answer, &gpr_free);
  return json::parse(answer, nullptr, /*allow_exceptions=*/false);
}

// 64-bit integers are strings, and those that are 0 are left out.
int64_t Count(const json& data, const char* name) {
  const auto found = data.find(name);
  int64_t count = 0;
  const bool given = found != data.end() && found->is_string();
  return given && absl::SimpleAtoi(found->get_ref<const std::string&>(), &count) ? count : 0;
}

int64_t LastServer() {
  int64_t last = 0;
  for (bool end = false; !end;) {
    const json page = Parse(grpc_channelz_get_servers(last + 1));
    if (page.is_discarded() || !page.contains("server")) break;
    end = page.value("end", false);
    for (const json& server : page["server"]) last = std::max(last, Count(server["ref"], "serverId"));
  }
  return last;
}

std::string PeerKey(absl::string_view base64_ip, int port) { return absl::StrCat(base64_ip, ":", port); }

// The key of a connection's peer; "": it has left.
std::string PeerOf(int descriptor) {
  sockaddr_storage address = {};
  socklen_t size = sizeof(address);
  if (getpeername(descriptor, reinterpret_cast<sockaddr*>(&address), &size) != 0) return "";
  if (address.ss_family == AF_INET) {
    const auto& ip4 = reinterpret_cast<const sockaddr_in&>(address);
    return PeerKey(absl::Base64Escape({reinterpret_cast<const char*>(&ip4.sin_addr), 4}), ntohs(ip4.sin_port));
  }
  const auto& ip6 = reinterpret_cast<const sockaddr_in6&>(address);
  absl::string_view ip(reinterpret_cast<const char*>(&ip6.sin6_addr), 16);
  if (IN6_IS_ADDR_V4MAPPED(&ip6.sin6_addr)) ip.remove_prefix(12);  // as gRPC writes it
  return PeerKey(absl::Base64Escape(ip), ntohs(ip6.sin6_port));
}

// Without those that the server has not read yet: it may be slow, which is not the client's fault.
int64_t BytesReceived(int descriptor) {
  tcp_info info = {};
  socklen_t size = sizeof(info);
  if (getsockopt(descriptor, IPPROTO_TCP, TCP_INFO, &info, &size) != 0) return 0;
  int unread = 0;
  if (ioctl(descriptor, SIOCINQ, &unread) != 0) unread = 0;
  return static_cast<int64_t>(info.tcpi_bytes_received) - unread;
}

struct Counters {
  int64_t open = 0;      // streams
  int64_t progress = 0;  // streams that began or ended, and messages that arrived
};

// Of each connection of the server, by its peer.
std::map<std::string, Counters> ReadCounters(int64_t server) {
  std::map<std::string, Counters> counters;
  const json sockets = Parse(grpc_channelz_get_server_sockets(server, 0, kMaxSockets));
  if (sockets.is_discarded() || !sockets.contains("socketRef")) return counters;
  for (const json& reference : sockets["socketRef"]) {
    const json answer = Parse(grpc_channelz_get_socket(Count(reference, "socketId")));
    if (answer.is_discarded() || !answer.contains("socket")) continue;  // it has just ended
    const json& socket = answer["socket"];
    if (!socket.contains("remote") || !socket["remote"].contains("tcpip_address")) continue;
    const json& peer = socket["remote"]["tcpip_address"];
    const json& data = socket["data"];
    const int64_t started = Count(data, "streamsStarted");
    const int64_t ended = Count(data, "streamsSucceeded") + Count(data, "streamsFailed");
    counters[PeerKey(peer.value("ip_address", ""), peer.value("port", 0))] = {
        started - ended, started + ended + Count(data, "messagesReceived")};
  }
  return counters;
}

// Adds the connections of a client that has more than `limit` of something, those with most first, until the rest fits.
template <typename Amount>
void EndLargest(const std::vector<ConnectionLoad>& loads, int64_t limit, absl::string_view what, Amount amount,
                std::map<int, std::string>* ended) {
  std::map<std::string, std::vector<const ConnectionLoad*>> clients;
  for (const ConnectionLoad& load : loads) {
    if (ended->count(load.descriptor) == 0) clients[load.client].push_back(&load);
  }
  for (auto& [client, held] : clients) {
    int64_t total = 0;
    for (const ConnectionLoad* load : held) total += amount(*load);
    std::sort(held.begin(), held.end(),
              [&](const ConnectionLoad* a, const ConnectionLoad* b) { return amount(*a) > amount(*b); });
    for (size_t i = 0; total > limit; ++i) {
      ended->emplace(held[i]->descriptor, absl::StrFormat("its client has %d %s, want at most %d", total, what, limit));
      total -= amount(*held[i]);
    }
  }
}

}  // namespace

std::map<int, std::string> FindFloods(std::vector<ConnectionLoad> loads, const ConnectionLimits& limits) {
  constexpr absl::string_view kStreams = "streams";
  constexpr absl::string_view kBytes = "bytes without a message";
  std::map<int, std::string> ended;
  for (const ConnectionLoad& load : loads) {
    if (load.streams > limits.streams) {
      ended[load.descriptor] = absl::StrFormat("it has %d %s, want at most %d", load.streams, kStreams, limits.streams);
    } else if (load.unfinished_bytes > limits.unfinished_bytes) {
      ended[load.descriptor] =
          absl::StrFormat("it sent %d %s, want at most %d", load.unfinished_bytes, kBytes, limits.unfinished_bytes);
    }
  }
  EndLargest(
      loads, limits.client_streams, kStreams, [](const ConnectionLoad& load) { return load.streams; }, &ended);
  EndLargest(
      loads, limits.client_unfinished_bytes, kBytes, [](const ConnectionLoad& load) { return load.unfinished_bytes; },
      &ended);
  return ended;
}

ConnectionWatch::ConnectionWatch(const ConnectionLimits& limits)
    : limits_(limits), server_(LastServer()), last_look_(SteadyNow()) {}

std::map<int, std::string> ConnectionWatch::Look(const std::map<int, std::string>& connections) {
  const std::map<std::string, Counters> counters = ReadCounters(server_);
  const absl::Time time = SteadyNow();
  const auto idle_bytes = static_cast<int64_t>(kIdleBytesPerSecond * absl::ToDoubleSeconds(time - last_look_));
  last_look_ = time;
  std::map<std::string, Progress> progress;
  std::vector<ConnectionLoad> loads;
  for (const auto& [descriptor, client] : connections) {
    const std::string peer = PeerOf(descriptor);
    const auto counted = counters.find(peer);
    if (counted == counters.end()) continue;  // in its handshake, or it has left
    const int64_t bytes = BytesReceived(descriptor);
    Progress& now = progress[peer];
    const auto before = progress_.find(peer);
    now = {counted->second.progress, bytes};
    if (before != progress_.end() && before->second.count == now.count) {
      now.bytes = std::min(bytes, before->second.bytes + idle_bytes);
    }
    loads.push_back({descriptor, client, counted->second.open, bytes - now.bytes});
  }
  progress_.swap(progress);
  return FindFloods(std::move(loads), limits_);
}

}  // namespace craftfleet::wire
