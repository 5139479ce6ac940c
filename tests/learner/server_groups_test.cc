#include "learner/server_groups.h"

#include <algorithm>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::Contains;
using testing::ElementsAre;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;
using Place = ServerGroups::Place;

std::string Server(int number) { return absl::StrFormat("server%04d:1", number); }

class ServerGroupsTest : public testing::Test {
 protected:
  void AddServers(int count, const Place& place) {
    for (int i = 0; i < count; ++i) groups_.PutServer(Server(added_++), place);
  }
  std::set<std::string> Ask(const std::string& actor, const Place& place = {}) {
    return groups_.GroupOf(actor, place).addresses;
  }
  // Asks for all actors until no group changes; returns the number of groups that have each server.
  std::map<std::string, int> Settle(int actors, const Place& place = {}) {
    std::map<std::string, int> groups;
    for (bool changes = true; changes;) {
      changes = false;
      groups.clear();
      for (int i = 0; i < actors; ++i) {
        const std::string name = absl::StrCat("actor", i);
        const int64_t before = generations_[name];
        const ServerGroups::Group group = groups_.GroupOf(name, place);
        generations_[name] = group.generation;
        changes |= before != group.generation;
        for (const std::string& address : group.addresses) ++groups[address];
      }
    }
    return groups;
  }

  ServerGroups groups_{0};
  std::map<std::string, int64_t> generations_;
  int added_ = 0;
};

TEST_F(ServerGroupsTest, InASmallFleetEachActorHasAllServers) {
  EXPECT_THAT(Ask("a"), IsEmpty());
  AddServers(ServerGroups::kSmall, {"host", ""});
  for (const char* actor : {"a", "b", "c"}) EXPECT_THAT(Ask(actor), SizeIs(ServerGroups::kSmall));
}

TEST_F(ServerGroupsTest, AGroupIsBoundedAndServersAreSharedEvenly) {
  AddServers(500, {});
  const std::map<std::string, int> groups = Settle(1000);
  EXPECT_THAT(Ask("actor0"), SizeIs(ServerGroups::kSmall));
  for (const auto& [address, count] : groups) EXPECT_EQ(count, 1000 * ServerGroups::kSmall / 500) << address;
}

TEST_F(ServerGroupsTest, FewActorsHaveMoreServersSoThatNoneIsIdle) {
  AddServers(100, {});
  EXPECT_THAT(Settle(5), SizeIs(100));
  EXPECT_THAT(Ask("actor0"), SizeIs(20));
  AddServers(1000, {});
  EXPECT_THAT(Settle(5), SizeIs(5 * ServerGroups::kLargest));
}

TEST_F(ServerGroupsTest, OneThatDiesIsReplaced) {
  AddServers(20, {});
  Settle(10);
  const std::set<std::string> before = Ask("actor3");
  const int64_t generation = groups_.GroupOf("actor3", {}).generation;
  groups_.RemoveServer(*before.begin());
  const std::set<std::string> after = Ask("actor3");
  EXPECT_THAT(after, SizeIs(ServerGroups::kSmall));
  EXPECT_THAT(after, Not(Contains(*before.begin())));
  EXPECT_GT(groups_.GroupOf("actor3", {}).generation, generation);
}

TEST_F(ServerGroupsTest, ANewServerTakesItsShare) {
  AddServers(20, {});
  Settle(10);
  groups_.PutServer("new:1", {});
  EXPECT_EQ(Settle(10).at("new:1"), 10 * ServerGroups::kSmall / 21);
}

TEST_F(ServerGroupsTest, AnActorHasTheServersOfItsHost) {
  for (const char* host : {"one", "two", "three"}) AddServers(2, {host, ""});
  for (const char* host : {"one", "two", "three"}) Ask(absl::StrCat("on ", host), {host, ""});
  EXPECT_THAT(Ask("on two", {"two", ""}), ElementsAre(Server(2), Server(3)));
  groups_.RemoveServer(Server(2));
  EXPECT_THAT(Ask("on two", {"two", ""}), ElementsAre(Server(3))) << "half of its share is enough";
  groups_.RemoveServer(Server(3));
  EXPECT_THAT(Ask("on two", {"two", ""}), ElementsAre(Server(0), Server(1), Server(4), Server(5)));
}

TEST_F(ServerGroupsTest, AnActorThatNoneOfItsServersAnswersHasOthers) {
  AddServers(2, {"one", ""});
  AddServers(3, {"two", ""});
  Ask("on two", {"two", ""});
  EXPECT_THAT(Ask("on one", {"one", ""}), ElementsAre(Server(0), Server(1)));
  groups_.Avoid("on one");
  EXPECT_THAT(Ask("on one", {"one", ""}), ElementsAre(Server(2), Server(3), Server(4)));
  EXPECT_THAT(Ask("on one", {"one", ""}), ElementsAre(Server(2), Server(3), Server(4))) << "and keeps them";
  groups_.RemoveServer(Server(1));
  Ask("on one", {"one", ""});
  groups_.PutServer(Server(1), {"one", ""});
  EXPECT_THAT(Ask("on one", {"one", ""}), ElementsAre(Server(1))) << "it came back";
  groups_.Avoid("on one");
  EXPECT_THAT(Ask("on one", {"one", ""}), ElementsAre(Server(0))) << "not avoided any more";
  EXPECT_THAT(Ask("on two", {"two", ""}), ElementsAre(Server(2), Server(3), Server(4))) << "it has its own";
}

TEST_F(ServerGroupsTest, AnActorThatNoServerAnswersKeepsItsGroup) {
  AddServers(2, {});
  const int64_t before = groups_.GroupOf("actor", {}).generation;
  groups_.Avoid("actor");
  groups_.Avoid("another");
  EXPECT_THAT(Ask("actor"), SizeIs(2));
  EXPECT_EQ(groups_.GroupOf("actor", {}).generation, before);
}

TEST_F(ServerGroupsTest, WithoutServersOnItsHostItHasThoseOfItsZone) {
  AddServers(3, {"one", "east"});
  AddServers(3, {"two", "west"});
  Ask("eastern", {"x", "east"});
  EXPECT_THAT(Ask("western", {"y", "west"}), ElementsAre(Server(3), Server(4), Server(5)));
  EXPECT_THAT(Ask("anywhere", {"z", ""}), SizeIs(6));
  EXPECT_THAT(Ask("nobody's", {"z", "north"}), SizeIs(6));
}

TEST_F(ServerGroupsTest, ManyActorsOnAHostWithFewServersAlsoHaveOthers) {
  AddServers(1, {"crowded", ""});
  AddServers(99, {"farm", ""});
  for (int i = 0; i < 100; ++i) Ask(absl::StrCat("actor", i), {"crowded", ""});
  const std::map<std::string, int> groups = Settle(100, {"crowded", ""});
  EXPECT_THAT(groups, SizeIs(100));
  EXPECT_LE(groups.at(Server(0)), 2 * ServerGroups::kSmall + 1) << "twice as many as on the average";
  EXPECT_GE(groups.at(Server(0)), 2 * ServerGroups::kSmall);
}

TEST_F(ServerGroupsTest, UnknownPlacesAreNotTheSamePlace) {
  AddServers(1, {"", ""});
  AddServers(1, {"host", "zone"});
  EXPECT_THAT(Ask("a", {"", ""}), SizeIs(2));
}

// Random histories, checked against counts made anew from the lists of servers and actors.
class GroupsHistory {
 public:
  explicit GroupsHistory(int seed) : random_(seed), hosts_(1 + Below(12)), zones_(1 + Below(4)) {}

  void Run() {
    for (int step = 0; step < 400 && !testing::Test::HasFatalFailure(); ++step) Step();
    Settle();
    if (!testing::Test::HasFatalFailure()) CheckSettled();
  }

 private:
  struct Actor {
    Place place;
    ServerGroups::Group group;
  };
  int Below(int n) { return static_cast<int>(random_() % n); }
  Place AnyPlace() {
    const int host = Below(hosts_);
    return {Below(5) == 0 ? "" : absl::StrCat("host", host),
            host % zones_ == 0 ? "" : absl::StrCat("zone", host % zones_)};
  }

  void Step() {
    const std::string address = Server(Below(60));
    const std::string actor = absl::StrCat("actor", Below(40));
    switch (Below(8)) {
      case 0:
      case 1: {
        const Place place = AnyPlace();
        servers_[address] = place;
        Both([&](ServerGroups* groups) { groups->PutServer(address, place); });
        return;
      }
      case 2:
        servers_.erase(address);
        return Both([&](ServerGroups* groups) { groups->RemoveServer(address); });
      case 3:
        actors_.erase(actor);
        return Both([&](ServerGroups* groups) { groups->RemoveActor(actor); });
      default:
        if (actors_.count(actor) == 0) actors_[actor].place = AnyPlace();
        Ask(actor);
    }
  }
  void Both(const std::function<void(ServerGroups*)>& change) {
    change(&groups_);
    change(&again_);
  }

  // Returns whether the group has changed.
  bool Ask(const std::string& name) {
    Actor& actor = actors_.at(name);
    const ServerGroups::Group before = actor.group;
    actor.group = groups_.GroupOf(name, actor.place);
    EXPECT_EQ(actor.group.addresses, again_.GroupOf(name, actor.place).addresses) << "the same calls, the same groups";
    EXPECT_EQ(actor.group.generation == before.generation,
              before.generation != 0 && actor.group.addresses == before.addresses);
    EXPECT_LE(actor.group.addresses.size(), Size());
    for (const std::string& address : actor.group.addresses) EXPECT_EQ(servers_.count(address), 1) << address;
    EXPECT_EQ(actor.group.addresses.empty(), servers_.empty());
    EXPECT_EQ(groups_.GroupOf(name, actor.place).generation, actor.group.generation) << "nothing has changed";
    return actor.group.generation != before.generation;
  }
  void Settle() {
    int rounds = 0;
    for (bool changes = true; changes; ++rounds) {
      ASSERT_LT(rounds, 200) << "groups change for ever";
      changes = false;
      for (auto& [name, actor] : actors_) changes |= Ask(name);
    }
  }

  static int Distance(const Place& a, const Place& b) {
    if (!a.host.empty() && a.host == b.host) return 0;
    return !a.zone.empty() && a.zone == b.zone ? 1 : 2;
  }
  size_t Size() const {
    const size_t actors = std::max<size_t>(actors_.size(), 1);
    return std::clamp((servers_.size() + actors - 1) / actors, ServerGroups::kSmall, ServerGroups::kLargest);
  }
  int ReachOf(const Place& place) const {
    for (int distance = 0; distance < 2; ++distance) {
      const std::string Place::*label = distance == 0 ? &Place::host : &Place::zone;
      if ((place.*label).empty()) continue;
      const auto servers = std::count_if(servers_.begin(), servers_.end(),
                                         [&](const auto& entry) { return entry.second.*label == place.*label; });
      const auto actors = std::count_if(actors_.begin(), actors_.end(),
                                        [&](const auto& entry) { return entry.second.place.*label == place.*label; });
      if (servers > 0 && 2 * servers * actors_.size() >= servers_.size() * actors) return distance;
    }
    return 2;
  }

  void CheckSettled() const {
    std::map<std::string, int> groups;
    for (const auto& [name, actor] : actors_) {
      for (const std::string& address : actor.group.addresses) ++groups[address];
    }
    const size_t places = actors_.size() * std::min(Size(), servers_.size());
    const int most = servers_.empty() ? 0 : static_cast<int>(2 * places / servers_.size()) + 1;
    for (const auto& [name, actor] : actors_) {
      const int reach = ReachOf(actor.place);
      size_t in_reach = 0;
      for (const auto& [address, place] : servers_) in_reach += Distance(actor.place, place) <= reach ? 1 : 0;
      ASSERT_EQ(actor.group.addresses.size(), std::min(Size(), in_reach)) << name;
      for (const auto& [unused, place] : servers_) {
        const int distance = Distance(actor.place, place);
        if (actor.group.addresses.count(unused) > 0 || (distance < reach && groups[unused] >= most)) continue;
        for (const std::string& used : actor.group.addresses) {
          const int used_distance = Distance(actor.place, servers_.at(used));
          ASSERT_LE(used_distance, reach) << name;
          ASSERT_FALSE(distance < used_distance) << name << " has " << used << ", and " << unused << " is nearer";
          if (used_distance == distance) {
            ASSERT_LE(groups[used], groups[unused] + 1)
                << name << " has " << used << ", not " << unused << " at distance " << distance << " of " << reach;
          }
        }
      }
    }
  }

  std::mt19937 random_;
  const int hosts_;
  const int zones_;
  ServerGroups groups_{0};
  ServerGroups again_{0};
  std::map<std::string, Place> servers_;
  std::map<std::string, Actor> actors_;
};

TEST(ServerGroupsProperty, GroupsFollowFromServersAndActorsAlone) {
  for (int seed = 0; seed < 300; ++seed) {
    SCOPED_TRACE(seed);
    GroupsHistory(seed).Run();
    if (testing::Test::HasFailure()) return;
  }
}

}  // namespace
}  // namespace craftfleet
