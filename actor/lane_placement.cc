#include "actor/lane_placement.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "common/base/check.h"

namespace craftfleet {

std::vector<int> LanePlacement::SetServers(const std::vector<std::string>& addresses) {
  const std::vector<Server> before = std::exchange(servers_, {});
  std::map<size_t, size_t> index_now;  // new numbers of servers that stay, by old number
  for (const std::string& address : addresses) {
    const auto known =
        std::find_if(before.begin(), before.end(), [&](const Server& server) { return server.address == address; });
    if (known != before.end()) {
      index_now[known - before.begin()] = servers_.size();
      servers_.push_back(*known);
    } else {
      servers_.push_back({address});
    }
  }
  std::vector<int> removed;
  std::map<int, size_t> server_of;
  for (const auto& [lane, server] : server_of_) {
    if (const auto now = index_now.find(server); now != index_now.end()) {
      server_of[lane] = now->second;
    } else {
      removed.push_back(lane);
    }
  }
  server_of_ = std::move(server_of);
  return removed;
}

std::optional<size_t> LanePlacement::Place(int lane, std::optional<size_t> except) {
  CRAFTFLEET_CHECK(server_of_.count(lane) == 0);
  std::optional<size_t> best;
  for (size_t k = 0; k < servers_.size(); ++k) {
    const size_t i = (first_ + k) % servers_.size();
    if (!servers_[i].available || i == except) continue;
    if (!best.has_value() || servers_[i].lanes < servers_[*best].lanes) best = i;
  }
  if (best.has_value()) {
    server_of_[lane] = *best;
    ++servers_[*best].lanes;
  }
  return best;
}

void LanePlacement::Remove(int lane) {
  const auto found = server_of_.find(lane);
  if (found == server_of_.end()) return;
  --servers_[found->second].lanes;
  server_of_.erase(found);
}

std::vector<int> LanePlacement::Lose(size_t server) {
  std::vector<int> lanes;
  for (const auto& [lane, on] : server_of_) {
    if (on == server) lanes.push_back(lane);
  }
  for (const int lane : lanes) Remove(lane);
  servers_[server].available = false;
  return lanes;
}

void LanePlacement::Clear() {
  server_of_.clear();
  for (Server& server : servers_) {
    server.available = false;
    server.lanes = 0;
  }
}

std::vector<int> LanePlacement::Excess() const {
  std::vector<int> counts;  // lanes by server after the moves
  for (const Server& server : servers_) counts.push_back(server.lanes);
  std::map<int, size_t> staying = server_of_;
  std::vector<int> excess;
  while (true) {
    std::optional<size_t> fullest;
    std::optional<size_t> emptiest;
    for (size_t i = 0; i < servers_.size(); ++i) {
      if (!servers_[i].available) continue;
      if (!fullest.has_value() || counts[i] > counts[*fullest]) fullest = i;
      if (!emptiest.has_value() || counts[i] < counts[*emptiest]) emptiest = i;
    }
    if (!fullest.has_value() || counts[*fullest] < counts[*emptiest] + 2) return excess;
    const auto lane =
        std::find_if(staying.begin(), staying.end(), [&](const auto& entry) { return entry.second == *fullest; });
    excess.push_back(lane->first);
    staying.erase(lane);
    --counts[*fullest];
    ++counts[*emptiest];
  }
}

std::optional<size_t> LanePlacement::ServerOf(int lane) const {
  const auto found = server_of_.find(lane);
  return found == server_of_.end() ? std::nullopt : std::make_optional(found->second);
}

std::vector<int> LanePlacement::Arrange(std::vector<int> lanes) const {
  std::stable_sort(lanes.begin(), lanes.end(), [this](int a, int b) { return server_of_.at(a) < server_of_.at(b); });
  return lanes;
}

std::vector<std::vector<int>> LanePlacement::ByServer(absl::Span<const int> lanes) const {
  std::vector<std::vector<int>> by_server(servers_.size());
  for (const int lane : lanes) {
    if (const auto found = server_of_.find(lane); found != server_of_.end()) by_server[found->second].push_back(lane);
  }
  return by_server;
}

}  // namespace craftfleet
