// Pausing play and draining actors.
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace {

using testing::IsEmpty;
using testing::SizeIs;

class SteeringTest : public testing::Test {
 protected:
  SteeringTest() { registry_.OpenIteration(/*last_fragment=*/2, /*policy_version=*/1); }

  TestRegistry::Grant Ask(const std::string& actor, const std::vector<Permit>& active = {}) {
    const auto grant = registry_.GetPermits(actor, active, /*capacity=*/100, absl::ZeroDuration());
    EXPECT_THAT(grant, IsOk());
    return grant.value_or(TestRegistry::Grant());
  }
  std::vector<Permit> Enter(const std::string& actor) {
    registry_.Join(actor, "address of " + actor);
    return Ask(actor).granted;
  }
  void Push(const std::string& actor, const std::vector<Permit>& permits) {
    for (const Permit& permit : permits) EXPECT_THAT(registry_.Accept(actor, permit, {"", {}}), IsOk());
  }

  FakeClock clock_;
  TestRegistry registry_{{4, absl::Seconds(5), absl::Seconds(1)}, std::vector<LaneRecord>(4), &clock_};
};

TEST_F(SteeringTest, WhilePausedNothingIsGrantedAndOutstandingFragmentsAreAccepted) {
  const std::vector<Permit> permits = Enter("a");
  EXPECT_FALSE(registry_.SetPaused(true));
  EXPECT_TRUE(Ask("a", permits).resting);
  EXPECT_EQ(registry_.permits(), 4);
  Push("a", permits);
  EXPECT_EQ(registry_.permits(), 0);
  EXPECT_THAT(Ask("a").granted, IsEmpty());
  EXPECT_THAT(Enter("b"), IsEmpty());
  clock_.Advance(absl::Seconds(3));
  EXPECT_THAT(Ask("a").granted, IsEmpty());
  EXPECT_THAT(Ask("b").granted, IsEmpty());

  EXPECT_TRUE(registry_.SetPaused(false));
  const TestRegistry::Grant grant = Ask("a");
  EXPECT_FALSE(grant.resting);
  EXPECT_THAT(grant.granted, SizeIs(2));  // b has the other share
  EXPECT_FALSE(registry_.SetPaused(false));
}

TEST_F(SteeringTest, LanesOfADrainedActorGoToOthers) {
  const std::vector<Permit> of_a = Enter("a");
  EXPECT_THAT(of_a, SizeIs(4));
  EXPECT_THAT(Enter("b"), IsEmpty());
  registry_.Drain("a");
  EXPECT_FALSE(registry_.IsDrained("a"));
  const TestRegistry::Grant grant = Ask("a", of_a);
  EXPECT_TRUE(grant.resting);
  EXPECT_THAT(grant.lost, IsEmpty());
  Push("a", {of_a[0], of_a[1]});
  EXPECT_THAT(Ask("b").granted, SizeIs(2));
  EXPECT_FALSE(registry_.IsDrained("a"));
  Push("a", {of_a[2], of_a[3]});
  EXPECT_TRUE(registry_.IsDrained("a"));
  EXPECT_THAT(Ask("b").lost, IsEmpty());
  EXPECT_THAT(Ask("a").granted, IsEmpty());
}

TEST_F(SteeringTest, ADrainedActorHasNoShare) {
  Push("a", Enter("a"));
  registry_.Join("b", "");
  registry_.Drain("a");
  EXPECT_TRUE(registry_.IsDrained("a"));
  EXPECT_THAT(Ask("b").granted, SizeIs(4));
}

TEST_F(SteeringTest, WithAllActorsDrainedNothingIsPlayedUntilAnotherJoins) {
  registry_.Join("a", "");
  registry_.Drain("a");
  EXPECT_THAT(Ask("a").granted, IsEmpty());
  EXPECT_THAT(Enter("a, restarted"), SizeIs(4));
}

TEST_F(SteeringTest, AMissingActorCountsAsDrained) {
  Enter("a");
  registry_.Drain("a");
  registry_.Leave("a");
  EXPECT_TRUE(registry_.IsDrained("a"));
  registry_.Drain("nobody");
  EXPECT_THAT(registry_.Actors(), IsEmpty());
}

}  // namespace
}  // namespace craftfleet
