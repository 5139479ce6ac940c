#include "learner/server_registry.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

constexpr absl::Duration kLease = absl::Seconds(5);

class ServerRegistryTest : public testing::Test {
 protected:
  std::vector<std::string> Addresses() {
    std::vector<std::string> addresses;
    for (const ServerRegistry::Server& server : registry_.Servers(&generation_)) addresses.push_back(server.address);
    return addresses;
  }

  FakeClock clock_;
  ServerRegistry registry_{kLease, &clock_};
  int64_t generation_ = 0;
};

TEST_F(ServerRegistryTest, ServersComeAndGo) {
  EXPECT_THAT(Addresses(), IsEmpty());
  registry_.Announce("s1", "a:1");
  registry_.Announce("s2", "b:1");
  EXPECT_THAT(Addresses(), ElementsAre("a:1", "b:1"));
  registry_.Leave("s1");
  registry_.Leave("nobody");
  EXPECT_THAT(Addresses(), ElementsAre("b:1"));
}

TEST_F(ServerRegistryTest, TheGenerationChangesWithTheAddressesAlone) {
  registry_.Announce("s1", "a:1");
  Addresses();
  const int64_t before = generation_;
  ASSERT_GT(before, 0);
  registry_.Announce("s1", "a:1");
  Addresses();
  EXPECT_EQ(generation_, before);
  registry_.Announce("s1 restarted", "a:1");
  Addresses();
  EXPECT_EQ(generation_, before) << "actors notice by their sessions";
  registry_.Announce("s2", "a:2");
  EXPECT_THAT(Addresses(), ElementsAre("a:1", "a:2"));
  EXPECT_NE(generation_, before);
}

TEST_F(ServerRegistryTest, AfterARestartAListFromBeforeIsKeptUntilServersHadTheTimeToAnnounceThemselves) {
  registry_.Announce("s1", "a:1");
  Addresses();
  const int64_t before = generation_;
  EXPECT_FALSE(registry_.ShouldKeep(before)) << "it is no restart";

  clock_.Advance(absl::Seconds(1) + absl::Nanoseconds(300));
  ServerRegistry restarted(kLease, &clock_);
  int64_t first = 0;
  restarted.Servers(&first);
  EXPECT_FALSE(restarted.ShouldKeep(first));
  EXPECT_TRUE(restarted.ShouldKeep(before));
  EXPECT_FALSE(restarted.ShouldKeep(0)) << "any server is better than none";
  restarted.Announce("s2", "b:1");
  int64_t now = 0;
  restarted.Servers(&now);
  EXPECT_GT(now, before) << "no list of one life is taken for one of another";
  EXPECT_FALSE(restarted.ShouldKeep(now));
  clock_.Advance(kLease);
  EXPECT_FALSE(restarted.ShouldKeep(before));
}

TEST_F(ServerRegistryTest, AServerThatSaysNothingIsForgotten) {
  registry_.Announce("s1", "a:1");
  registry_.Announce("s2", "b:1");
  clock_.Advance(kLease / 2);
  registry_.Announce("s2", "b:1");
  clock_.Advance(kLease / 2);
  EXPECT_THAT(Addresses(), ElementsAre("b:1"));
}

TEST_F(ServerRegistryTest, ARestartedServerTakesThePlaceOfItsFormerSelf) {
  registry_.Announce("host-1-aaaa", "a:1");
  registry_.Announce("host-2-bbbb", "a:1");
  EXPECT_THAT(Addresses(), ElementsAre("a:1"));
  registry_.Leave("host-1-aaaa");  // a late word
  EXPECT_THAT(Addresses(), ElementsAre("a:1"));
}

TEST_F(ServerRegistryTest, ADrainedServerIsListedNoMoreAndSaysWhenItIsEmpty) {
  registry_.Announce("s1", "a:1", 3);
  registry_.Announce("s2", "b:1", 0);
  EXPECT_THAT(Addresses(), ElementsAre("a:1", "b:1"));
  const int64_t before = generation_;
  registry_.Drain("s1");
  EXPECT_THAT(Addresses(), ElementsAre("b:1"));
  EXPECT_NE(generation_, before);
  EXPECT_EQ(registry_.All().size(), 2);
  EXPECT_FALSE(registry_.IsDrained("s1"));
  registry_.Announce("s1", "a:1", 1);
  EXPECT_FALSE(registry_.IsDrained("s1"));
  registry_.Announce("s1", "a:1", 0);
  EXPECT_TRUE(registry_.IsDrained("s1"));
  EXPECT_THAT(Addresses(), ElementsAre("b:1"));
  EXPECT_FALSE(registry_.IsDrained("s2"));
}

TEST_F(ServerRegistryTest, TheNextProcessAtAnAddressIsNotDrained) {
  registry_.Announce("s1", "a:1", 0);
  registry_.Drain("s1");
  registry_.Announce("s1 again", "a:1", 0);
  EXPECT_THAT(Addresses(), ElementsAre("a:1"));
  EXPECT_TRUE(registry_.IsDrained("s1"));
}

}  // namespace
}  // namespace craftfleet
