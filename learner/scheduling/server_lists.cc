#include "learner/scheduling/server_lists.h"

#include <algorithm>
#include <cstddef>
#include <tuple>
#include <utility>
#include <vector>

#include "common/base/fnv1a.h"
#include "common/base/seeds.h"

namespace craftfleet {

void ServerLists::PutServer(const std::string& address, const WorkerClient& client) {
  const auto [known, is_new] = servers_.try_emplace(address, client);
  if (!is_new && known->second.identity == client.identity && known->second.host == client.host) return;
  known->second = client;
  ++changes_;
}

void ServerLists::RemoveServer(absl::string_view address) {
  const auto known = servers_.find(address);
  if (known == servers_.end()) return;
  for (auto& [name, actor] : actors_) actor.avoided.erase(known->first);
  servers_.erase(known);
  ++changes_;
}

void ServerLists::RemoveActor(absl::string_view name) {
  const auto known = actors_.find(name);
  if (known == actors_.end()) return;
  actors_.erase(known);
  ++changes_;
}

void ServerLists::Avoid(absl::string_view name) {
  const auto known = actors_.find(name);
  if (known == actors_.end()) return;
  Actor& actor = known->second;
  for (const std::string& address : actor.list.addresses) {
    if (servers_.count(address) > 0) actor.avoided.insert(address);
  }
  const bool has_others = std::any_of(servers_.begin(), servers_.end(),
                                      [&](const auto& server) { return actor.avoided.count(server.first) == 0; });
  if (!has_others) actor.avoided.clear();
  actor.seen = -1;
}

const ServerLists::List& ServerLists::ListOf(const std::string& name, const std::string& host) {
  const auto [known, is_new] = actors_.try_emplace(name);
  Actor& actor = known->second;
  if (is_new || actor.host != host) {
    actor.host = host;
    ++changes_;
  }
  if (actor.seen != changes_) {
    std::set<std::string> addresses = Choose(name, actor);
    if (is_new || addresses != actor.list.addresses) actor.list = {++generation_, std::move(addresses)};
    actor.seen = changes_;
  }
  return actor.list;
}

size_t ServerLists::SizeOf(absl::string_view name) const {
  const auto known = actors_.find(name);
  return known == actors_.end() ? 0 : known->second.list.addresses.size();
}

std::set<std::string> ServerLists::Choose(const std::string& name, const Actor& actor) const {
  const uint64_t seed = Fnv1a(kFnv1aBasis, name);
  std::map<std::string, int> avoided_of;  // by client
  for (const std::string& address : actor.avoided) ++avoided_of[servers_.at(address).Name()];
  std::vector<std::tuple<int, bool, uint64_t, const std::string*>> ranked;
  size_t near = 0;
  for (const auto& [address, client] : servers_) {
    if (actor.avoided.count(address) > 0) continue;
    const bool is_far = client.host.empty() || client.host != actor.host;
    near += is_far ? 0 : 1;
    ranked.emplace_back(avoided_of[client.Name()], is_far, MixBits(Fnv1a(seed, address)), &address);
  }
  const auto neighbours = static_cast<size_t>(std::count_if(
      actors_.begin(), actors_.end(), [&](const auto& other) { return other.second.host == actor.host; }));
  const bool near_suffice = near > 0 && 2 * near * actors_.size() >= servers_.size() * neighbours;
  const size_t share = (servers_.size() + actors_.size() - 1) / actors_.size();
  const size_t size = std::min(near_suffice ? near : ranked.size(), std::clamp(2 * share, kFewest, kMost));
  std::nth_element(ranked.begin(), ranked.begin() + static_cast<std::ptrdiff_t>(size), ranked.end());
  ranked.resize(size);
  std::set<std::string> addresses;
  for (const auto& [avoided, is_far, hash, address] : ranked) addresses.insert(*address);
  return addresses;
}

}  // namespace craftfleet
