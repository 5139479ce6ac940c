// How actors share lanes, and which fragments are accepted.
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/lane_fleet.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

using Verdict = LaneScheduler::Verdict;

TEST(LaneScheduler, ALoneActorGetsEveryLane) {
  LaneFleet fleet(4);
  EXPECT_THAT(fleet.Enter("a"), ElementsAre(Permit{0, 0, kVersion}, Permit{1, 0, kVersion}, Permit{2, 0, kVersion},
                                            Permit{3, 0, kVersion}));
}

TEST(LaneScheduler, GrantsNoMoreThanTheActorCanPlay) {
  LaneFleet fleet(4);
  const std::vector<Permit> first = fleet.Enter("a", 2);
  EXPECT_THAT(Lanes(first), ElementsAre(0, 1));
  EXPECT_THAT(fleet.Ask("a", first, 2).granted, IsEmpty());
  EXPECT_THAT(Lanes(fleet.Ask("a", first, 3).granted), ElementsAre(2));
  EXPECT_THAT(Lanes(fleet.Ask("a", {}, -1).granted), IsEmpty());
}

TEST(LaneScheduler, ActorsGetFairShares) {
  LaneFleet fleet(16);
  fleet.registry.Join("a", "");
  fleet.registry.Join("b", "");
  fleet.registry.Join("c", "");
  EXPECT_THAT(fleet.Ask("a").granted, SizeIs(6));
  EXPECT_THAT(fleet.Ask("b").granted, SizeIs(5));
  EXPECT_THAT(fleet.Ask("c").granted, SizeIs(5));
}

TEST(LaneScheduler, SharesDifferByOneAtMostWhateverTheNumberOfActors) {
  for (int actors = 1; actors <= 20; ++actors) {
    LaneFleet fleet(16);
    for (int i = 0; i < actors; ++i) fleet.registry.Join(std::to_string(i), "");
    size_t total = 0;
    for (int i = 0; i < actors; ++i) {
      const size_t share = fleet.Ask(std::to_string(i)).granted.size();
      EXPECT_GE(share, 16 / actors) << actors;
      EXPECT_LE(share, (16 + actors - 1) / actors) << actors;
      total += share;
    }
    EXPECT_EQ(total, 16) << actors;
  }
}

TEST(LaneScheduler, LanesBeyondAnActorsCapacityGoToTheOthers) {
  LaneFleet fleet(16);
  fleet.registry.Join("small", "");
  fleet.registry.Join("a", "");
  fleet.registry.Join("b", "");
  EXPECT_THAT(fleet.Ask("small", {}, 2).granted, SizeIs(2));
  EXPECT_THAT(fleet.Ask("a").granted, SizeIs(7));
  EXPECT_THAT(fleet.Ask("b").granted, SizeIs(7));
}

TEST(LaneScheduler, TheOddLaneGoesToTheFirstActorThatAsks) {
  LaneFleet fleet(5, 100);
  std::vector<Permit> of_a = fleet.Enter("a");
  fleet.registry.Join("b", "");
  std::vector<Permit> of_b;
  // Both continue; the excess lane of `a` moves to `b` with the next fragments.
  for (int i = 0; i < 6; ++i) {
    for (const Permit& permit : of_a) EXPECT_EQ(fleet.Push("a", permit), Verdict::kAccepted);
    for (const Permit& permit : of_b) EXPECT_EQ(fleet.Push("b", permit), Verdict::kAccepted);
    of_b = fleet.Ask("b").granted;
    of_a = fleet.Ask("a").granted;
  }
  EXPECT_EQ(of_a.size() + of_b.size(), 5);
  EXPECT_GE(of_b.size(), 2);
  EXPECT_LE(of_b.size(), 3);
}

TEST(LaneScheduler, AnActorKeepsItsLanes) {
  LaneFleet fleet(8);
  fleet.registry.Join("a", "");
  fleet.registry.Join("b", "");
  const std::vector<Permit> of_a = fleet.Ask("a").granted;
  const std::vector<Permit> of_b = fleet.Ask("b").granted;
  for (const Permit& permit : of_a) EXPECT_EQ(fleet.Push("a", permit), Verdict::kAccepted);
  for (const Permit& permit : of_b) EXPECT_EQ(fleet.Push("b", permit), Verdict::kAccepted);
  fleet.registry.OpenIteration(2, kVersion + 1);
  EXPECT_EQ(Lanes(fleet.Ask("b").granted), Lanes(of_b));
  EXPECT_EQ(Lanes(fleet.Ask("a").granted), Lanes(of_a));
}

TEST(LaneScheduler, ANewActorGetsTheOthersExcessLanes) {
  LaneFleet fleet(4);
  const std::vector<Permit> of_a = fleet.Enter("a");
  EXPECT_THAT(fleet.Enter("b"), IsEmpty());  // all permits are outstanding
  for (const Permit& permit : of_a) EXPECT_EQ(fleet.Push("a", permit), Verdict::kAccepted);
  fleet.registry.OpenIteration(2, kVersion + 1);
  EXPECT_THAT(Lanes(fleet.Ask("b").granted), ElementsAre(0, 1));
  EXPECT_THAT(Lanes(fleet.Ask("a").granted), ElementsAre(2, 3));
}

TEST(LaneScheduler, GrantsAreForTheNextFragmentUnderTheIterationsWeights) {
  LaneFleet fleet(1, 3);
  fleet.registry.Join("a", "");
  for (int64_t fragment = 0; fragment < 3; ++fragment) {
    const std::vector<Permit> granted = fleet.Ask("a").granted;
    ASSERT_THAT(granted, ElementsAre(Permit{0, fragment, kVersion}));
    EXPECT_THAT(fleet.Ask("a", granted).granted, IsEmpty()) << "one fragment of a lane at a time";
    EXPECT_EQ(fleet.Push("a", granted[0]), Verdict::kAccepted);
  }
  EXPECT_THAT(fleet.Ask("a").granted, IsEmpty());
  fleet.registry.OpenIteration(4, kVersion + 1);
  EXPECT_THAT(fleet.Ask("a").granted, ElementsAre(Permit{0, 3, kVersion + 1}));
}

TEST(LaneScheduler, ContinuesFromGivenRecords) {
  LaneFleet fleet({{7, {"seven", {7}}}, {6, {"six", {6}}}}, 7);
  EXPECT_THAT(fleet.Enter("a"), ElementsAre(Permit{1, 6, kVersion}));
  EXPECT_EQ(fleet.registry.Snapshot(0, 7).value(), (LaneSnapshot{"seven", {7}}));
}

TEST(LaneScheduler, AnUnknownActorMustJoin) {
  LaneFleet fleet(1);
  EXPECT_THAT(fleet.registry.GetPermits("stranger", {}, kAll, absl::InfiniteDuration()),
              StatusIs(absl::StatusCode::kAborted, AllOf(HasSubstr("stranger"), HasSubstr("join again"))));
}

TEST(LaneScheduler, LeaveFreesLanesForOthers) {
  LaneFleet fleet(2);
  EXPECT_THAT(fleet.Enter("a"), SizeIs(2));
  EXPECT_THAT(fleet.Enter("b"), IsEmpty());
  fleet.registry.Leave("a");
  EXPECT_THAT(Lanes(fleet.Ask("b").granted), ElementsAre(0, 1));
  EXPECT_THAT(fleet.registry.GetPermits("a", {}, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("a")));
}

TEST(LaneScheduler, ReportsLostPermits) {
  LaneFleet fleet(3, 2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  EXPECT_EQ(fleet.Push("a", of_a[0]), Verdict::kAccepted);
  fleet.clock.Advance(absl::Seconds(6));
  EXPECT_THAT(fleet.Enter("b", 2), SizeIs(2));  // lanes 0 and 1
  fleet.registry.Join("a", "");
  const Permit nonsense = {17, 0, kVersion};
  const TestRegistry::Grant grant = fleet.Ask("a", {of_a[0], of_a[1], of_a[2], nonsense});
  // The fragment of lane 0 was accepted, and its verdict is on the way. Lane 2 has no holder.
  EXPECT_THAT(grant.lost, ElementsAre(of_a[1], of_a[2], nonsense));
  EXPECT_THAT(Lanes(grant.granted), ElementsAre(2));
}

TEST(LaneScheduler, AnUnreportedPermitIsRevoked) {
  LaneFleet fleet(2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  EXPECT_THAT(fleet.Ask("a", {of_a[0]}).granted, ElementsAre(of_a[1]));
  fleet.Ask("a", {of_a[1]}, 1);
  EXPECT_EQ(fleet.Push("a", of_a[0]), Verdict::kExpired);
  EXPECT_EQ(fleet.Push("a", of_a[1]), Verdict::kAccepted);
}

// Its environment servers may be unreachable; without this it would get the same lanes forever.
TEST(LaneScheduler, ReturnedLanesGoToOtherActorsFirst) {
  LaneFleet fleet(4);
  fleet.registry.Join("a", "");
  const std::vector<Permit> of_b = fleet.Enter("b");
  ASSERT_THAT(of_b, SizeIs(2));
  ASSERT_THAT(fleet.Ask("a").granted, SizeIs(2));
  EXPECT_THAT(fleet.Ask("a", {}).granted, IsEmpty());
  for (const Permit& permit : of_b) EXPECT_EQ(fleet.Push("b", permit), Verdict::kAccepted);
  fleet.clock.Advance(absl::Milliseconds(500));
  EXPECT_THAT(fleet.Ask("a", {}).granted, IsEmpty());
  fleet.clock.Advance(absl::Milliseconds(501));
  EXPECT_THAT(Lanes(fleet.Ask("b").granted), ElementsAre(2, 3));
}

TEST(LaneScheduler, AReturnedLaneGoesBackIfNoOtherActorTakesIt) {
  LaneFleet fleet(4);
  fleet.registry.Join("b", "");
  const std::vector<Permit> of_a = fleet.Enter("a");
  EXPECT_THAT(fleet.Ask("a", {}).granted, IsEmpty());
  fleet.clock.Advance(absl::Milliseconds(1001));
  EXPECT_EQ(fleet.Ask("a", {}).granted, of_a);
}

TEST(LaneScheduler, AcceptsAFragmentOnce) {
  LaneFleet fleet(2);
  const std::vector<Permit> of_a = fleet.Enter("a");
  EXPECT_EQ(fleet.Push("a", of_a[0]), Verdict::kAccepted);
  EXPECT_EQ(fleet.Push("a", of_a[0]), Verdict::kDuplicate);
  EXPECT_EQ(fleet.Push("b", of_a[0]), Verdict::kDuplicate);
  EXPECT_EQ(fleet.registry.Records()[0].next_fragment, 1);
}

TEST(LaneScheduler, RefusesFragmentsWithoutAPermit) {
  LaneFleet fleet(2, 2);
  const std::vector<Permit> of_a = fleet.Enter("a", 1);
  EXPECT_EQ(fleet.Push("b", of_a[0]), Verdict::kExpired) << "another actor's permit";
  EXPECT_EQ(fleet.Push("a", {1, 0, kVersion}), Verdict::kExpired) << "there is no permit for this lane";
  EXPECT_EQ(fleet.Push("a", {0, 1, kVersion}), Verdict::kExpired) << "the fragment after the permitted one";
  EXPECT_EQ(fleet.registry.Records()[0].next_fragment, 0);
  EXPECT_EQ(fleet.registry.Records()[1].next_fragment, 0);
}

TEST(LaneScheduler, RefusesFragmentsOfOtherWeights) {
  LaneFleet fleet(1);
  const Permit permit = fleet.Enter("a")[0];
  EXPECT_THAT(fleet.registry.Accept("a", {0, 0, kVersion - 1}, {"s", {}}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("policy_version 19"), HasSubstr("lane 0"), HasSubstr("want 20"))));
  EXPECT_EQ(fleet.Push("a", permit), Verdict::kAccepted) << "the permit is still valid";
}

TEST(LaneScheduler, KeepsTheSnapshotOfTheLastAcceptedFragment) {
  LaneFleet fleet({{3, {"before 3", {0.5F}}}}, 5);
  const Permit permit = fleet.Enter("a")[0];
  EXPECT_EQ(fleet.registry.Snapshot(0, 3).value(), (LaneSnapshot{"before 3", {0.5F}}));
  EXPECT_EQ(fleet.Push("a", permit), Verdict::kAccepted);
  EXPECT_EQ(fleet.Push("a", permit), Verdict::kDuplicate);
  EXPECT_EQ(fleet.registry.Snapshot(0, 4).value(), (LaneSnapshot{"after 3", {1.5F}}));
  EXPECT_EQ(fleet.registry.Records()[0].snapshot, (LaneSnapshot{"after 3", {1.5F}}));
  EXPECT_THAT(fleet.registry.Snapshot(0, 3),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("lane 0 is at fragment 4, not 3")));
  for (const int lane : {-1, 1}) {
    EXPECT_THAT(fleet.registry.Snapshot(lane, 0), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want 0..0")));
  }
}

TEST(LaneScheduler, AnUnclaimedLaneGoesToAnyActorAfterAWhile) {
  LaneFleet fleet(4);
  fleet.registry.Join("slow", "");
  const std::vector<Permit> of_fast = fleet.Enter("fast");
  ASSERT_THAT(of_fast, SizeIs(2));
  for (const Permit& permit : of_fast) EXPECT_EQ(fleet.Push("fast", permit), Verdict::kAccepted);
  EXPECT_THAT(fleet.Ask("fast").granted, IsEmpty()) << "the rest is the other actor's share";
  fleet.clock.Advance(absl::Milliseconds(1001));
  EXPECT_THAT(fleet.Ask("fast").granted, SizeIs(2));
}

TEST(LaneScheduler, ReportsTheEndOfTheRun) {
  LaneFleet fleet(1);
  const std::vector<Permit> of_a = fleet.Enter("a");
  EXPECT_FALSE(fleet.Ask("a", of_a).finished);
  std::thread waiting(
      [&] { EXPECT_TRUE(fleet.registry.GetPermits("a", of_a, kAll, absl::InfiniteDuration())->finished); });
  fleet.registry.Finish();
  waiting.join();
  std::thread leaving([&] { fleet.registry.Leave("a"); });
  fleet.registry.WaitUntilEmpty(absl::InfiniteDuration());
  leaving.join();
  EXPECT_THAT(fleet.registry.Actors(), IsEmpty());
}

TEST(LaneScheduler, ReportsActors) {
  LaneFleet fleet(3, 2);
  const std::vector<Permit> of_a = fleet.Enter("a", 2);
  fleet.Push("a", of_a[0]);
  fleet.clock.Advance(absl::Seconds(2));
  fleet.registry.Join("b", "10.0.0.2:7");
  const std::vector<LaneActor> actors = fleet.registry.Actors();
  ASSERT_THAT(actors, SizeIs(2));
  EXPECT_EQ(actors[0].worker->name, "a");
  EXPECT_EQ(actors[0].worker->address, "address of a");
  EXPECT_THAT(actors[0].permits, SizeIs(1));
  EXPECT_EQ(actors[0].fragments, 1);
  EXPECT_EQ(actors[1].worker->address, "10.0.0.2:7");
  EXPECT_THAT(actors[1].permits, IsEmpty());
}

}  // namespace
}  // namespace craftfleet
