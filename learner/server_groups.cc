#include "learner/server_groups.h"

#include <algorithm>
#include <iterator>
#include <tuple>

namespace craftfleet {

void ServerGroups::PutServer(const std::string& address, const Place& place) {
  Server& server = servers_[address];
  if (server.is_there && server.place == place) return;
  if (server.is_there) Unrank(address, server);
  server.place = place;
  server.is_there = true;
  Rank(address, server);
  ++changes_;
}

void ServerGroups::RemoveServer(absl::string_view address) {
  const auto known = servers_.find(address);
  if (known == servers_.end() || !known->second.is_there) return;
  Unrank(known->first, known->second);
  known->second.is_there = false;
  if (known->second.groups == 0) servers_.erase(known);
  ++changes_;
}

void ServerGroups::Rank(const std::string& address, const Server& server) {
  ForSites(server.place, [&](Site* site) { site->servers.insert({server.groups, address}); });
}

void ServerGroups::Unrank(const std::string& address, const Server& server) {
  ForSites(server.place, [&](Site* site) { site->servers.erase({server.groups, address}); });
}

void ServerGroups::RemoveActor(absl::string_view name) {
  const auto known = actors_.find(name);
  if (known == actors_.end()) return;
  for (const std::string& address : known->second.group.addresses) CountGroups(address, -1);
  AddActor(known->second.place, -1);
  actors_.erase(known);
}

const ServerGroups::Group& ServerGroups::GroupOf(const std::string& name, const Place& place) {
  const auto [known, is_new] = actors_.try_emplace(name);
  Actor& actor = known->second;
  if (is_new || !(actor.place == place)) {
    if (!is_new) AddActor(actor.place, -1);
    AddActor(place, 1);
    actor.place = place;
  }
  if (actor.seen != changes_) {
    if (Adapt(&actor) || is_new) actor.group.generation = ++generation_;
    actor.seen = changes_;
  }
  return actor.group;
}

void ServerGroups::Avoid(absl::string_view name) {
  const auto known = actors_.find(name);
  if (known == actors_.end()) return;
  Actor& actor = known->second;
  actor.avoided = actor.group.addresses;
  if (!HasOthers(all_, actor)) {
    actor.avoided.clear();
    return;
  }
  for (const std::string& address : actor.avoided) Drop(&actor, address);
}

size_t ServerGroups::SizeOf(absl::string_view name) const {
  const auto known = actors_.find(name);
  return known == actors_.end() ? 0 : known->second.group.addresses.size();
}

ServerGroups::Distance ServerGroups::DistanceOf(const Place& actor, const Place& server) {
  if (!actor.host.empty() && actor.host == server.host) return kSameHost;
  return !actor.zone.empty() && actor.zone == server.zone ? kSameZone : kElsewhere;
}

void ServerGroups::ForSites(const Place& place, const std::function<void(Site*)>& change) {
  const auto change_in = [&](Sites* sites, const std::string& name) {
    if (name.empty()) return;
    Site& site = (*sites)[name];
    change(&site);
    if (site.empty()) sites->erase(name);
  };
  change_in(&hosts_, place.host);
  change_in(&zones_, place.zone);
  change(&all_);
}

void ServerGroups::AddActor(const Place& place, int count) {
  ForSites(place, [count](Site* site) { site->actors += count; });
  ++changes_;
}

void ServerGroups::CountGroups(const std::string& address, int by) {
  const auto known = servers_.find(address);
  Server& server = known->second;
  if (server.is_there) Unrank(address, server);
  server.groups += by;
  if (server.is_there) Rank(address, server);
  if (!server.is_there && server.groups == 0) servers_.erase(known);
  ++changes_;
}

size_t ServerGroups::Size() const {
  const auto actors = static_cast<size_t>(std::max(all_.actors, 1));
  return std::clamp((servers() + actors - 1) / actors, kSmall, kLargest);
}

int ServerGroups::MostGroups() const {
  const size_t places = static_cast<size_t>(all_.actors) * std::min(Size(), servers());
  return static_cast<int>(2 * places / std::max<size_t>(servers(), 1)) + 1;
}

bool ServerGroups::Suffices(const Site& site) const {
  return 2 * site.servers.size() * static_cast<size_t>(all_.actors) >= servers() * static_cast<size_t>(site.actors);
}

const ServerGroups::Site& ServerGroups::SiteOf(const Place& place, Distance distance) const {
  static const Site nowhere;
  if (distance == kElsewhere) return all_;
  const Sites& sites = distance == kSameHost ? hosts_ : zones_;
  const auto site = sites.find(distance == kSameHost ? place.host : place.zone);
  return site == sites.end() ? nowhere : site->second;
}

ServerGroups::Distance ServerGroups::ReachOf(const Actor& actor) const {
  for (const Distance distance : {kSameHost, kSameZone}) {
    const Site& site = SiteOf(actor.place, distance);
    if (HasOthers(site, actor) && Suffices(site)) return distance;
  }
  return kElsewhere;
}

bool ServerGroups::HasOthers(const Site& site, const Actor& actor) const {
  return std::any_of(site.servers.begin(), site.servers.end(),
                     [&](const auto& server) { return actor.avoided.count(server.second) == 0; });
}

const std::string* ServerGroups::Best(const Actor& actor, Distance reach) const {
  for (const Distance distance : {kSameHost, kSameZone, kElsewhere}) {
    if (distance > reach) break;
    for (const auto& [groups, address] : SiteOf(actor.place, distance).servers) {
      if (distance < reach && groups >= MostGroups()) break;
      if (actor.group.addresses.count(address) == 0 && actor.avoided.count(address) == 0) return &address;
    }
  }
  return nullptr;
}

const std::string& ServerGroups::Worst(const Actor& actor) const {
  return *std::max_element(actor.group.addresses.begin(), actor.group.addresses.end(),
                           [&](const std::string& a, const std::string& b) {
                             const Server& one = servers_.at(a);
                             const Server& other = servers_.at(b);
                             return std::make_tuple(DistanceOf(actor.place, one.place), one.groups) <
                                    std::make_tuple(DistanceOf(actor.place, other.place), other.groups);
                           });
}

bool ServerGroups::Adapt(Actor* actor) {
  for (auto avoided = actor->avoided.begin(); avoided != actor->avoided.end();) {
    const auto server = servers_.find(*avoided);
    const bool is_there = server != servers_.end() && server->second.is_there;
    avoided = is_there ? std::next(avoided) : actor->avoided.erase(avoided);
  }
  const Distance reach = ReachOf(*actor);
  bool changed = Shrink(actor, reach);
  while (actor->group.addresses.size() < Size()) {
    const std::string* const best = Best(*actor, reach);
    if (best == nullptr) break;
    Take(actor, *best);
    changed = true;
  }
  return Improve(actor, reach) || changed;
}

bool ServerGroups::Shrink(Actor* actor, Distance reach) {
  const size_t before = actor->group.addresses.size();
  for (const std::string& address :
       std::vector<std::string>(actor->group.addresses.begin(), actor->group.addresses.end())) {
    const Server& server = servers_.at(address);
    if (!server.is_there || DistanceOf(actor->place, server.place) > reach) Drop(actor, address);
  }
  while (actor->group.addresses.size() > Size()) Drop(actor, std::string(Worst(*actor)));
  return actor->group.addresses.size() < before;
}

bool ServerGroups::Improve(Actor* actor, Distance reach) {
  for (bool changed = false;; changed = true) {
    const std::string* const best = actor->group.addresses.empty() ? nullptr : Best(*actor, reach);
    if (best == nullptr) return changed;
    const std::string worst = Worst(*actor);
    const Server& given = servers_.at(worst);
    const Server& taken = servers_.at(*best);
    const Distance far = DistanceOf(actor->place, given.place);
    const Distance near = DistanceOf(actor->place, taken.place);
    // One that differs by one group would only move the difference.
    if (near > far || (near == far && taken.groups + 1 >= given.groups)) return changed;
    const std::string address = *best;
    Drop(actor, worst);
    Take(actor, address);
  }
}

void ServerGroups::Take(Actor* actor, const std::string& address) {
  const std::string taken = address;  // `address` may be part of a ranking, which changes
  actor->group.addresses.insert(taken);
  CountGroups(taken, 1);
}

void ServerGroups::Drop(Actor* actor, const std::string& address) {
  actor->group.addresses.erase(address);
  CountGroups(address, -1);
}

}  // namespace craftfleet
