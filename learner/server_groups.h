// Which actor plays on which environment servers.

#ifndef CRAFTFLEET_LEARNER_SERVER_GROUPS_H_
#define CRAFTFLEET_LEARNER_SERVER_GROUPS_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/string_view.h>

namespace craftfleet {

// Deals out environment servers. An actor with sessions on all of thousands of servers would be slow to start, and each
// server that comes or goes would be news for every actor. So each actor has a group of servers.
//
// Size: up to kSmall servers; where there are more for each actor, so many that each server is in a group, at most
// kLargest.
//
// Which servers: those on the actor's host first, then those with its zone label, then the others; of equally near ones
// those that the fewest groups have. An actor has servers elsewhere only if its host (or its zone) has less than half
// of the servers that the fleet has for so many actors. Near servers with twice as many groups as the average are full.
// Results don't depend on any of this.
//
// A group adapts when its actor asks for it: servers that are gone are replaced, and new ones are taken in exchange for
// farther or busier ones. Until something changes, asking costs next to nothing. The same calls give the same groups.
// Not thread-safe.
class ServerGroups {
 public:
  static constexpr size_t kSmall = 8;
  static constexpr size_t kLargest = 64;

  // Where a process runs. Empty: not known, which is no place at all.
  struct Place {
    std::string host;
    std::string zone;
    friend bool operator==(const Place& a, const Place& b) { return a.host == b.host && a.zone == b.zone; }
  };
  struct Group {
    int64_t generation = 0;  // changes with the addresses; unique among all groups
    std::set<std::string> addresses;
  };

  // Generations are greater than `generation`.
  explicit ServerGroups(int64_t generation) : generation_(generation) {}

  // Adds a server, or moves it to another place.
  void PutServer(const std::string& address, const Place& place);
  // Removes a server; ignored if there is no such server.
  void RemoveServer(absl::string_view address);
  // Forgets an actor; ignored if it never asked.
  void RemoveActor(absl::string_view actor);

  // None of its group's servers answers this actor: its next group has others, near or far, if there are any. Those
  // that it had come back if the others do not answer either, or after they were removed. Ignored if it never asked.
  void Avoid(absl::string_view actor);

  // The group of `actor`, which is at `place`. The reference is valid until the next call.
  const Group& GroupOf(const std::string& actor, const Place& place);

  size_t servers() const { return all_.servers.size(); }
  // The number of servers in the actor's group, as it last got it; 0: it never asked.
  size_t SizeOf(absl::string_view actor) const;

 private:
  enum Distance { kSameHost, kSameZone, kElsewhere };
  // Servers by the number of groups that have them, then by address.
  using Ranking = std::set<std::pair<int, std::string>>;
  struct Server {
    Place place;
    int groups = 0;         // that have it
    bool is_there = false;  // false: removed, but still in groups whose actors have not asked since
  };
  struct Actor {
    Place place;
    Group group;
    std::set<std::string> avoided;  // servers that did not answer it
    int64_t seen = -1;              // `changes_` when the group was last found to be right
  };
  // The servers and actors of a host, of a zone, or all.
  struct Site {
    Ranking servers;
    int actors = 0;
    bool empty() const { return servers.empty() && actors == 0; }
  };
  using Sites = std::map<std::string, Site, std::less<>>;

  static Distance DistanceOf(const Place& actor, const Place& server);
  // Calls `change` for each site that `place` belongs to; forgets those that are then empty.
  void ForSites(const Place& place, const std::function<void(Site*)>& change);
  void AddActor(const Place& place, int count);
  // Adds the server to the rankings of its sites, or removes it.
  void Rank(const std::string& address, const Server& server);
  void Unrank(const std::string& address, const Server& server);
  // Changes the number of groups that have the server.
  void CountGroups(const std::string& address, int by);

  size_t Size() const;
  // How many groups a near server may be in.
  int MostGroups() const;
  // How far away the actor's servers may be.
  Distance ReachOf(const Actor& actor) const;
  // Whether `site` has a server that the actor does not avoid.
  bool HasOthers(const Site& site, const Actor& actor) const;
  // Whether the servers of `site` are at least half of those that its actors would have on average.
  bool Suffices(const Site& site) const;
  const Site& SiteOf(const Place& place, Distance distance) const;
  // The best server that the actor does not have, not farther than `reach`; null: none.
  const std::string* Best(const Actor& actor, Distance reach) const;
  // The farthest of the group's servers, of these the one in the most groups.
  const std::string& Worst(const Actor& actor) const;

  // Adapts the group. Returns whether it has changed.
  bool Adapt(Actor* actor);
  // Drops the servers that are gone, too far away or too many.
  bool Shrink(Actor* actor, Distance reach);
  // Exchanges servers for better ones.
  bool Improve(Actor* actor, Distance reach);
  void Take(Actor* actor, const std::string& address);
  void Drop(Actor* actor, const std::string& address);

  int64_t generation_;   // of the last group that changed
  int64_t changes_ = 0;  // of anything that a group follows from
  std::map<std::string, Server, std::less<>> servers_;
  std::map<std::string, Actor, std::less<>> actors_;
  Sites hosts_;
  Sites zones_;
  Site all_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_SERVER_GROUPS_H_
