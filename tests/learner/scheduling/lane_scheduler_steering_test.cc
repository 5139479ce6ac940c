// Pausing play and draining actors.
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/learner/scheduling/lane_fleet.h"

namespace craftfleet {
namespace lane_scheduler_steering_test {

using testing::IsEmpty;
using testing::SizeIs;

TEST(Steering, WhilePausedNothingIsGrantedAndOutstandingFragmentsAreAccepted) {
  LaneFleet fleet(4, 2);
  const std::vector<Permit> permits = fleet.Enter("a");
  EXPECT_FALSE(fleet.registry.SetPaused(true));
  EXPECT_THAT(fleet.Ask("a", permits).lost, IsEmpty());
  EXPECT_EQ(fleet.registry.permits(), 4);
  for (const Permit& permit : permits) fleet.Push("a", permit);
  EXPECT_EQ(fleet.registry.permits(), 0);
  EXPECT_THAT(fleet.Ask("a").granted, IsEmpty());
  EXPECT_THAT(fleet.Enter("b"), IsEmpty());
  fleet.clock.Advance(absl::Seconds(3));
  EXPECT_THAT(fleet.Ask("a").granted, IsEmpty());
  EXPECT_THAT(fleet.Ask("b").granted, IsEmpty());

  EXPECT_TRUE(fleet.registry.SetPaused(false));
  EXPECT_THAT(fleet.Ask("a").granted, SizeIs(2));  // b has the other share
  EXPECT_FALSE(fleet.registry.SetPaused(false));
}

TEST(Steering, LanesOfADrainedActorGoToOthers) {
  LaneFleet fleet(4, 2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  EXPECT_THAT(of_a, SizeIs(4));
  EXPECT_THAT(fleet.Enter("b"), IsEmpty());
  fleet.registry.Drain("a");
  EXPECT_FALSE(fleet.registry.IsDrained("a"));
  EXPECT_THAT(fleet.Ask("a", of_a).lost, IsEmpty());
  for (const Permit& permit : {of_a[0], of_a[1]}) fleet.Push("a", permit);
  EXPECT_THAT(fleet.Ask("b").granted, SizeIs(2));
  EXPECT_FALSE(fleet.registry.IsDrained("a"));
  for (const Permit& permit : {of_a[2], of_a[3]}) fleet.Push("a", permit);
  EXPECT_TRUE(fleet.registry.IsDrained("a"));
  EXPECT_THAT(fleet.Ask("b").lost, IsEmpty());
  EXPECT_THAT(fleet.Ask("a").granted, IsEmpty());
}

TEST(Steering, ADrainedActorHasNoShare) {
  LaneFleet fleet(4, 2);
  for (const Permit& permit : fleet.Enter("a")) fleet.Push("a", permit);
  fleet.registry.Join("b", "");
  fleet.registry.Drain("a");
  EXPECT_TRUE(fleet.registry.IsDrained("a"));
  EXPECT_THAT(fleet.Ask("b").granted, SizeIs(4));
}

TEST(Steering, WithAllActorsDrainedNothingIsPlayedUntilAnotherJoins) {
  LaneFleet fleet(4, 2);
  fleet.registry.Join("a", "");
  fleet.registry.Drain("a");
  EXPECT_THAT(fleet.Ask("a").granted, IsEmpty());
  EXPECT_THAT(fleet.Enter("a, restarted"), SizeIs(4));
}

TEST(Steering, AMissingActorCountsAsDrained) {
  LaneFleet fleet(4, 2);
  fleet.Enter("a");
  fleet.registry.Drain("a");
  fleet.registry.Leave("a");
  EXPECT_TRUE(fleet.registry.IsDrained("a"));
  fleet.registry.Drain("nobody");
  EXPECT_THAT(fleet.registry.Actors(), IsEmpty());
}

}  // namespace lane_scheduler_steering_test
}  // namespace craftfleet
