#include "actor/env_server_tracker.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_format.h>

namespace craftfleet {

void EnvServerTracker::Update(int loop, std::vector<Server> servers) {
  const MutexLock lock(&mu_);
  reports_[loop] = std::move(servers);
}

std::vector<v1::Peer> EnvServerTracker::All() const {
  std::map<std::string, Server> servers;
  {
    const MutexLock lock(&mu_);
    for (const auto& [loop, report] : reports_) {
      for (const Server& server : report) {
        Server& all = servers[server.address];
        all.connected |= server.connected;
        all.lanes += server.lanes;
        if (server.connected && server.summary.memory_bytes() > 0) all.summary = server.summary;
        if (!server.error.empty()) all.error = server.error;
        all.slow = server.slow;  // as `step_time`: all loops have it from the same ServerHealth
        all.step_time = server.step_time;
      }
    }
  }
  std::vector<v1::Peer> peers;
  for (auto& [address, server] : servers) {
    v1::Peer& peer = peers.emplace_back();
    peer.set_name("environment server " + address);
    peer.set_role("envserver");
    peer.set_address(address);
    peer.set_step_ms(absl::ToDoubleMilliseconds(server.step_time));
    if (!server.error.empty() && !server.slow) {
      peer.set_health(v1::Peer::NOT_ANSWERING);
      peer.set_state("not answering");
      continue;
    }
    peer.set_health(server.slow ? v1::Peer::SLOW : server.connected ? v1::Peer::OK : v1::Peer::LOST);
    peer.set_state(server.slow || server.connected ? absl::StrFormat("%d lanes", server.lanes) : "not reachable");
    if (peer.step_ms() > 0) absl::StrAppendFormat(peer.mutable_state(), ", %.1f ms a step", peer.step_ms());
    // The server sends summaries only while games are played there; earlier ones are outdated.
    if (server.lanes > 0 && server.summary.memory_bytes() > 0) *peer.mutable_summary() = std::move(server.summary);
  }
  return peers;
}

std::vector<v1::Peer> EnvServerTracker::Next(size_t count) { return Rotate(All(), count); }

std::vector<v1::Peer> EnvServerTracker::NextUnusable(size_t count) {
  std::vector<v1::Peer> all = All();
  all.erase(std::remove_if(all.begin(), all.end(), [](const v1::Peer& peer) { return peer.health() == v1::Peer::OK; }),
            all.end());
  return Rotate(std::move(all), count);
}

std::vector<v1::Peer> EnvServerTracker::Rotate(std::vector<v1::Peer> all, size_t count) {
  const MutexLock lock(&mu_);
  const std::string last = last_;
  const auto first = std::find_if(all.begin(), all.end(), [&](const v1::Peer& peer) { return peer.address() > last; });
  std::rotate(all.begin(), first, all.end());
  if (all.size() > count) all.resize(count);
  if (!all.empty()) last_ = all.back().address();
  return all;
}

}  // namespace craftfleet
