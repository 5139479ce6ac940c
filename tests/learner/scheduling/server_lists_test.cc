#include "learner/scheduling/server_lists.h"

#include <algorithm>
#include <cstddef>
#include <map>
#include <set>
#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

std::set<std::string> Of(ServerLists* lists, const std::string& actor, const std::string& host = "") {
  return lists->ListOf(actor, host).addresses;
}

// `count` servers on `host`, which may be empty.
void PutServers(ServerLists* lists, const std::string& host, int count) {
  for (int i = 0; i < count; ++i) lists->PutServer(absl::StrCat(host.empty() ? "any" : host, ":", i), {"", host});
}

TEST(ServerLists, AreEmptyWithoutServers) {
  ServerLists lists(7);
  EXPECT_THAT(Of(&lists, "a"), IsEmpty());
  EXPECT_GT(lists.ListOf("a", "").generation, 7);
}

TEST(ServerLists, HaveAllOfAFewServers) {
  ServerLists lists(0);
  PutServers(&lists, "", 8);
  for (const char* actor : {"a", "b", "c"}) EXPECT_EQ(Of(&lists, actor).size(), 8) << actor;
}

TEST(ServerLists, HaveAHandfulOfManyServers) {
  ServerLists lists(0);
  PutServers(&lists, "", 500);
  std::map<std::string, int> uses;
  for (int i = 0; i < 1000; ++i) Of(&lists, absl::StrCat("actor ", i));
  for (int i = 0; i < 1000; ++i) {
    const std::set<std::string> addresses = Of(&lists, absl::StrCat("actor ", i));
    EXPECT_EQ(addresses.size(), ServerLists::kFewest);
    for (const std::string& address : addresses) ++uses[address];
  }
  EXPECT_EQ(uses.size(), 500) << "each is used";
  for (const auto& [address, number] : uses) EXPECT_LT(number, 4 * 16) << address;
}

TEST(ServerLists, AreLongerWhereThereAreMoreServersThanActors) {
  ServerLists lists(0);
  PutServers(&lists, "", 40);
  Of(&lists, "a");
  Of(&lists, "b");
  EXPECT_EQ(Of(&lists, "a").size(), 40);
  PutServers(&lists, "", 1000);
  EXPECT_EQ(Of(&lists, "a").size(), ServerLists::kMost);
}

TEST(ServerLists, AServerThatComesOrGoesChangesFewLists) {
  ServerLists lists(0);
  PutServers(&lists, "", 100);
  std::map<std::string, int64_t> generations;
  for (int i = 0; i < 100; ++i) Of(&lists, absl::StrCat(i));
  for (int i = 0; i < 100; ++i) generations[absl::StrCat(i)] = lists.ListOf(absl::StrCat(i), "").generation;
  lists.PutServer("new:1", {});
  int changed = 0;
  for (const auto& [actor, generation] : generations) {
    const ServerLists::List& list = lists.ListOf(actor, "");
    EXPECT_EQ(list.generation != generation, list.addresses.count("new:1") > 0);
    changed += list.generation != generation ? 1 : 0;
  }
  EXPECT_GT(changed, 0);
  EXPECT_LT(changed, 30);
  lists.RemoveServer("new:1");
  for (const auto& [actor, generation] : generations) EXPECT_EQ(Of(&lists, actor).count("new:1"), 0);
}

TEST(ServerLists, PreferTheActorsHost) {
  ServerLists lists(0);
  PutServers(&lists, "east", 2);
  PutServers(&lists, "west", 2);
  Of(&lists, "other", "west");
  EXPECT_THAT(Of(&lists, "a", "east"), ElementsAre("east:0", "east:1"));
  lists.RemoveServer("east:0");
  lists.RemoveServer("east:1");
  EXPECT_THAT(Of(&lists, "a", "east"), ElementsAre("west:0", "west:1")) << "others instead";
}

TEST(ServerLists, HaveServersElsewhereIfTheHostHasTooFew) {
  ServerLists lists(0);
  PutServers(&lists, "east", 1);
  PutServers(&lists, "west", 20);
  for (int i = 0; i < 4; ++i) Of(&lists, absl::StrCat("east actor ", i), "east");
  const std::set<std::string> addresses = Of(&lists, "east actor 0", "east");
  EXPECT_GT(addresses.size(), 1);
  EXPECT_EQ(addresses.count("east:0"), 1) << "its own first";
}

TEST(ServerLists, AnUnknownHostIsNobodysHost) {
  ServerLists lists(0);
  PutServers(&lists, "", 2);
  PutServers(&lists, "east", 2);
  EXPECT_EQ(Of(&lists, "a").size(), 4);
}

TEST(ServerLists, AvoidedServersComeBackIfTheOthersDoNotAnswerEither) {
  ServerLists lists(0);
  PutServers(&lists, "east", 1);
  PutServers(&lists, "west", 1);
  lists.Avoid("a");  // it never asked
  EXPECT_THAT(Of(&lists, "a", "east"), ElementsAre("east:0"));
  lists.Avoid("a");
  EXPECT_THAT(Of(&lists, "a", "east"), ElementsAre("west:0"));
  lists.Avoid("a");
  EXPECT_THAT(Of(&lists, "a", "east"), ElementsAre("east:0"));
}

TEST(ServerLists, AfterOneClientsServersOthersComeFirst) {
  ServerLists lists(0);
  for (int i = 0; i < 2048; ++i) lists.PutServer(absl::StrCat("made-up:", i), {"bad", "east"});
  lists.PutServer("real:1", {"good", "east"});
  if (Of(&lists, "a", "east").count("real:1") == 0) lists.Avoid("a");
  EXPECT_EQ(Of(&lists, "a", "east").count("real:1"), 1);
}

TEST(ServerLists, AllServersAreTriedBeforeOneComesBack) {
  ServerLists lists(0);
  constexpr size_t kServers = 5 * ServerLists::kMost;
  PutServers(&lists, "", kServers);
  std::set<std::string> tried;
  for (int i = 0; i < 5; ++i) {
    const std::set<std::string> list = Of(&lists, "a");
    tried.insert(list.begin(), list.end());
    lists.Avoid("a");
  }
  EXPECT_EQ(tried.size(), kServers);
}

TEST(ServerLists, AnAvoidedServerComesBackAfterItWasRemoved) {
  ServerLists lists(0);
  PutServers(&lists, "east", 1);
  PutServers(&lists, "west", 1);
  Of(&lists, "a", "east");
  lists.Avoid("a");
  EXPECT_THAT(Of(&lists, "a", "east"), ElementsAre("west:0"));
  lists.RemoveServer("east:0");
  lists.PutServer("east:0", {"", "east"});
  EXPECT_THAT(Of(&lists, "a", "east"), ElementsAre("east:0"));
}

TEST(ServerLists, WithoutOtherServersNoneIsAvoided) {
  ServerLists lists(0);
  PutServers(&lists, "", 1);
  const int64_t generation = lists.ListOf("a", "").generation;
  lists.Avoid("a");
  EXPECT_THAT(Of(&lists, "a"), ElementsAre("any:0"));
  EXPECT_EQ(lists.ListOf("a", "").generation, generation);
}

TEST(ServerLists, KeepTheirGenerationWhileNothingChanges) {
  ServerLists lists(0);
  PutServers(&lists, "", 3);
  const int64_t generation = lists.ListOf("a", "").generation;
  EXPECT_EQ(lists.SizeOf("a"), 3);
  PutServers(&lists, "", 3);
  EXPECT_EQ(lists.ListOf("a", "").generation, generation);
  EXPECT_NE(lists.ListOf("b", "").generation, generation) << "unique among all lists";
  lists.RemoveActor("a");
  EXPECT_EQ(lists.SizeOf("a"), 0);
}

}  // namespace
}  // namespace craftfleet
