// Leases: how long an actor that is silent, slow or cut off keeps its lanes.
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/lane_fleet.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

using Verdict = LaneScheduler::Verdict;

TEST(LaneLeases, ALapsedLeaseFreesLanes) {
  LaneFleet fleet(2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  fleet.registry.Join("b", "");
  fleet.clock.Advance(absl::Seconds(5));
  EXPECT_THAT(fleet.Ask("b").granted, IsEmpty()) << "the lease is not over yet";
  fleet.clock.Advance(absl::Milliseconds(1));
  EXPECT_THAT(fleet.Ask("b").granted, SizeIs(2));
  EXPECT_EQ(fleet.Push("a", of_a[0]), Verdict::kExpired);
  EXPECT_THAT(fleet.registry.GetPermits("a", of_a, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("join")));
}

// The guaranteed times: an actor that was suspended for 4 s keeps its lanes; one suspended for 15 s learns that it lost
// them.
TEST(LaneLeases, ASlowActorKeepsItsLanes) {
  LaneFleet fleet(2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  fleet.registry.Join("b", "");
  fleet.clock.Advance(absl::Seconds(4));
  EXPECT_THAT(fleet.Ask("b").granted, IsEmpty());
  EXPECT_THAT(fleet.Ask("a", of_a).lost, IsEmpty());
  EXPECT_EQ(fleet.registry.counters().lapsed, 0);
  for (int i = 0; i < 15; ++i) {
    fleet.clock.Advance(absl::Seconds(1));
    fleet.Ask("b", {});
  }
  EXPECT_EQ(fleet.registry.counters().lapsed, 2);
  EXPECT_THAT(fleet.registry.GetPermits("a", of_a, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("join again")));
  fleet.registry.Join("a", "");
  EXPECT_EQ(fleet.Ask("a", of_a).lost, of_a);
}

// The system date is set forward and back by an hour.
TEST(LaneLeases, SettingTheDateChangesNoLease) {
  LaneFleet fleet(2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  fleet.registry.Join("b", "");
  for (const absl::Duration ahead : {absl::Hours(1), -absl::Hours(1), absl::ZeroDuration()}) {
    fleet.clock.SetWallAhead(ahead);
    EXPECT_THAT(fleet.Ask("a", of_a).lost, IsEmpty());
    EXPECT_THAT(fleet.Ask("b").granted, IsEmpty());
  }
  EXPECT_EQ(fleet.registry.counters().lapsed, 0);
  fleet.clock.SetWallAhead(-absl::Hours(1));
  fleet.clock.Advance(absl::Milliseconds(5001));
  fleet.Ask("b");
  EXPECT_EQ(fleet.registry.counters().lapsed, 2) << "nor does it prolong a lease";
}

TEST(LaneLeases, ALeaseLastsTwiceAsLongIfNoOtherActorAsks) {
  LaneFleet fleet(2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  fleet.clock.Advance(absl::Seconds(10));
  EXPECT_THAT(fleet.Ask("a", of_a).lost, IsEmpty());
  fleet.clock.Advance(absl::Milliseconds(10001));
  EXPECT_THAT(fleet.registry.GetPermits("a", of_a, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("join again")));
  EXPECT_EQ(fleet.registry.counters().lapsed, 2);
}

TEST(LaneLeases, ABrokenConnectionEndsTheLeaseSooner) {
  LaneFleet fleet(2);
  fleet.Enter("a");
  fleet.registry.Join("b", "");
  fleet.registry.OnConnectionLost("a");
  fleet.clock.Advance(absl::Seconds(2));
  EXPECT_THAT(fleet.Ask("b").granted, IsEmpty()) << "it may reconnect";
  fleet.clock.Advance(absl::Milliseconds(1));
  EXPECT_THAT(fleet.Ask("b").granted, SizeIs(2));
  EXPECT_EQ(fleet.registry.counters().lapsed, 2);
  fleet.registry.OnConnectionLost("a");  // no longer known
}

TEST(LaneLeases, AReconnectedActorKeepsItsLease) {
  LaneFleet fleet(2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  fleet.registry.Join("b", "");
  fleet.registry.OnConnectionLost("a");
  fleet.clock.Advance(absl::Milliseconds(1900));
  EXPECT_THAT(fleet.Ask("a", of_a).lost, IsEmpty());
  fleet.clock.Advance(absl::Seconds(4));
  EXPECT_THAT(fleet.Ask("b").granted, IsEmpty());
}

TEST(LaneLeases, ABrokenConnectionDoesNotLengthenALease) {
  LaneFleet fleet(2);
  fleet.Enter("a");
  fleet.registry.Join("b", "");
  fleet.clock.Advance(absl::Milliseconds(4500));
  fleet.registry.OnConnectionLost("a");
  fleet.clock.Advance(absl::Milliseconds(501));
  EXPECT_THAT(fleet.Ask("b").granted, SizeIs(2));
}

TEST(LaneLeases, ARestartedActorIsANewActor) {
  LaneFleet fleet(2);
  const std::vector<Permit> of_old = fleet.Enter("host-1-aaaa");
  ASSERT_THAT(of_old, SizeIs(2));
  EXPECT_THAT(fleet.Enter("host-1-bbbb"), IsEmpty()) << "the permits of the old process are still outstanding";
  EXPECT_EQ(fleet.Ask("host-1-bbbb", of_old).lost, of_old) << "they are not its permits";
  EXPECT_EQ(fleet.Push("host-1-bbbb", of_old[0]), Verdict::kExpired);
  fleet.clock.Advance(absl::Milliseconds(5001));
  const std::vector<Permit> of_new = fleet.Ask("host-1-bbbb").granted;
  EXPECT_EQ(of_new, of_old);
  EXPECT_EQ(fleet.Push("host-1-aaaa", of_old[0]), Verdict::kExpired) << "a late fragment of the old process";
  EXPECT_THAT(fleet.registry.GetPermits("host-1-aaaa", of_old, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("join again")))
      << "a late request of the old process";
  EXPECT_EQ(fleet.Push("host-1-bbbb", of_new[0]), Verdict::kAccepted);
}

// The registry is bounded even if actors crash right after joining, again and again, under new names.
TEST(LaneLeases, ActorsThatJoinAndVanishAreForgotten) {
  LaneFleet fleet(2);
  for (int i = 0; i < 1000; ++i) {
    fleet.registry.Join(std::to_string(i), "");
    fleet.clock.Advance(absl::Seconds(1));
  }
  EXPECT_LE(fleet.registry.Actors().size(), 6);
}

TEST(LaneLeases, AskingRenewsTheLease) {
  LaneFleet fleet(2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  for (int i = 0; i < 5; ++i) {
    fleet.clock.Advance(absl::Seconds(4));
    EXPECT_THAT(fleet.Ask("a", of_a).lost, IsEmpty());
  }
  EXPECT_EQ(fleet.Push("a", of_a[0]), Verdict::kAccepted);
}

TEST(LaneLeases, AnAcceptedFragmentRenewsTheLease) {
  LaneFleet fleet(2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  fleet.clock.Advance(absl::Seconds(4));
  EXPECT_EQ(fleet.Push("a", of_a[0]), Verdict::kAccepted);
  fleet.clock.Advance(absl::Seconds(4));
  EXPECT_THAT(fleet.Enter("b"), IsEmpty());
  EXPECT_EQ(fleet.Push("a", of_a[1]), Verdict::kAccepted);
}

}  // namespace
}  // namespace craftfleet
