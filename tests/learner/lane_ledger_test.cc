#include "learner/lane_ledger.h"

#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

using Verdict = LaneLedger::Verdict;

constexpr int kAll = 4096;  // capacity of an actor that takes what it gets
constexpr int64_t kVersion = 20;

// A ledger of `lanes` new lanes, its clock and short forms of its calls; one iteration of `fragments` is open.
class Book {
 public:
  explicit Book(int lanes, int64_t fragments = 1) : Book(std::vector<LaneRecord>(lanes), fragments) {}
  Book(std::vector<LaneRecord> records, int64_t last_fragment)
      : ledger({static_cast<int>(records.size()), absl::Seconds(5), absl::Seconds(1)}, records, &clock) {
    ledger.OpenIteration(last_fragment, kVersion);
  }

  LaneLedger::Grant Ask(const std::string& actor, const std::vector<Permit>& active = {}, int capacity = kAll) {
    const auto grant = ledger.GetPermits(actor, active, capacity, absl::ZeroDuration());
    EXPECT_THAT(grant, IsOk());
    return grant.value_or(LaneLedger::Grant());
  }
  // Joins and asks.
  std::vector<Permit> Enter(const std::string& actor, int capacity = kAll) {
    ledger.Join(actor, "address of " + actor);
    return Ask(actor, {}, capacity).granted;
  }
  Verdict Push(const std::string& actor, const Permit& permit) {
    const auto verdict = ledger.Accept(actor, permit, {"after " + std::to_string(permit.fragment), {1.5F}});
    EXPECT_THAT(verdict, IsOk());
    return verdict.value_or(Verdict::kExpired);
  }

  FakeClock clock;
  LaneLedger ledger;
};

std::vector<int> Lanes(const std::vector<Permit>& permits) {
  std::vector<int> lanes;
  lanes.reserve(permits.size());
  for (const Permit& permit : permits) lanes.push_back(permit.lane);
  return lanes;
}

TEST(LaneLedger, AnActorAloneGetsEveryLane) {
  Book book(4);
  EXPECT_THAT(book.Enter("a"), ElementsAre(Permit{0, 0, kVersion}, Permit{1, 0, kVersion}, Permit{2, 0, kVersion},
                                           Permit{3, 0, kVersion}));
}

TEST(LaneLedger, GrantsNoMoreThanTheActorCanPlay) {
  Book book(4);
  const std::vector<Permit> first = book.Enter("a", 2);
  EXPECT_THAT(Lanes(first), ElementsAre(0, 1));
  EXPECT_THAT(book.Ask("a", first, 2).granted, IsEmpty());
  EXPECT_THAT(Lanes(book.Ask("a", first, 3).granted), ElementsAre(2));
  EXPECT_THAT(Lanes(book.Ask("a", {}, -1).granted), IsEmpty());
}

TEST(LaneLedger, ActorsGetFairShares) {
  Book book(16);
  book.ledger.Join("a", "");
  book.ledger.Join("b", "");
  book.ledger.Join("c", "");
  EXPECT_THAT(book.Ask("a").granted, SizeIs(6));
  EXPECT_THAT(book.Ask("b").granted, SizeIs(5));
  EXPECT_THAT(book.Ask("c").granted, SizeIs(5));
}

TEST(LaneLedger, SharesDifferByOneAtMostWhateverTheNumberOfActors) {
  for (int actors = 1; actors <= 20; ++actors) {
    Book book(16);
    for (int i = 0; i < actors; ++i) book.ledger.Join(std::to_string(i), "");
    size_t total = 0;
    for (int i = 0; i < actors; ++i) {
      const size_t share = book.Ask(std::to_string(i)).granted.size();
      EXPECT_GE(share, 16 / actors) << actors;
      EXPECT_LE(share, (16 + actors - 1) / actors) << actors;
      total += share;
    }
    EXPECT_EQ(total, 16) << actors;
  }
}

TEST(LaneLedger, WhatOneCannotPlayIsSharedByTheOthers) {
  Book book(16);
  book.ledger.Join("small", "");
  book.ledger.Join("a", "");
  book.ledger.Join("b", "");
  EXPECT_THAT(book.Ask("small", {}, 2).granted, SizeIs(2));
  EXPECT_THAT(book.Ask("a").granted, SizeIs(7));
  EXPECT_THAT(book.Ask("b").granted, SizeIs(7));
}

TEST(LaneLedger, TheOddLaneGoesToWhoAsksFirstAndNobodyHasTwoMore) {
  Book book(5, 100);
  std::vector<Permit> of_a = book.Enter("a");
  book.ledger.Join("b", "");
  std::vector<Permit> of_b;
  // Both play on; what `a` has too much of moves to `b` with its next fragments.
  for (int i = 0; i < 6; ++i) {
    for (const Permit& permit : of_a) EXPECT_EQ(book.Push("a", permit), Verdict::kAccepted);
    for (const Permit& permit : of_b) EXPECT_EQ(book.Push("b", permit), Verdict::kAccepted);
    of_b = book.Ask("b").granted;
    of_a = book.Ask("a").granted;
  }
  EXPECT_EQ(of_a.size() + of_b.size(), 5);
  EXPECT_GE(of_b.size(), 2);
  EXPECT_LE(of_b.size(), 3);
}

TEST(LaneLedger, AnActorKeepsItsLanes) {
  Book book(8);
  book.ledger.Join("a", "");
  book.ledger.Join("b", "");
  const std::vector<Permit> of_a = book.Ask("a").granted;
  const std::vector<Permit> of_b = book.Ask("b").granted;
  for (const Permit& permit : of_a) EXPECT_EQ(book.Push("a", permit), Verdict::kAccepted);
  for (const Permit& permit : of_b) EXPECT_EQ(book.Push("b", permit), Verdict::kAccepted);
  book.ledger.OpenIteration(2, kVersion + 1);
  EXPECT_EQ(Lanes(book.Ask("b").granted), Lanes(of_b));
  EXPECT_EQ(Lanes(book.Ask("a").granted), Lanes(of_a));
}

TEST(LaneLedger, ANewActorGetsWhatOthersHaveBeyondTheirShare) {
  Book book(4);
  const std::vector<Permit> of_a = book.Enter("a");
  EXPECT_THAT(book.Enter("b"), IsEmpty());  // everything is out
  for (const Permit& permit : of_a) EXPECT_EQ(book.Push("a", permit), Verdict::kAccepted);
  book.ledger.OpenIteration(2, kVersion + 1);
  EXPECT_THAT(Lanes(book.Ask("b").granted), ElementsAre(0, 1));
  EXPECT_THAT(Lanes(book.Ask("a").granted), ElementsAre(2, 3));
}

TEST(LaneLedger, GrantsAreForTheNextFragmentUnderTheIterationsWeights) {
  Book book(1, 3);
  book.ledger.Join("a", "");
  for (int64_t fragment = 0; fragment < 3; ++fragment) {
    const std::vector<Permit> granted = book.Ask("a").granted;
    ASSERT_THAT(granted, ElementsAre(Permit{0, fragment, kVersion}));
    EXPECT_THAT(book.Ask("a", granted).granted, IsEmpty()) << "one fragment of a lane at a time";
    EXPECT_EQ(book.Push("a", granted[0]), Verdict::kAccepted);
  }
  EXPECT_THAT(book.Ask("a").granted, IsEmpty());
  book.ledger.OpenIteration(4, kVersion + 1);
  EXPECT_THAT(book.Ask("a").granted, ElementsAre(Permit{0, 3, kVersion + 1}));
}

TEST(LaneLedger, GoesOnFromGivenRecords) {
  Book book({{7, {"seven", {7}}}, {6, {"six", {6}}}}, 7);
  EXPECT_THAT(book.Enter("a"), ElementsAre(Permit{1, 6, kVersion}));
  EXPECT_EQ(book.ledger.Snapshot(0, 7).value(), (LaneSnapshot{"seven", {7}}));
}

TEST(LaneLedger, TakesOverWhatAnEarlierStartAccepted) {
  Book book({{5, {"before 5", {}}}, {6, {"before 6", {}}}}, 7);
  EXPECT_TRUE(book.ledger.Restore({0, 5, kVersion}, {"after 5", {}}));
  EXPECT_FALSE(book.ledger.Restore({0, 5, kVersion}, {"again", {}}));
  EXPECT_FALSE(book.ledger.Restore({1, 7, kVersion}, {"too far", {}}));
  EXPECT_EQ(book.ledger.Snapshot(0, 6).value().game, "after 5");
  EXPECT_THAT(book.Enter("a"), ElementsAre(Permit{0, 6, kVersion}, Permit{1, 6, kVersion}));
  EXPECT_FALSE(book.ledger.Restore({1, 6, kVersion}, {"late", {}})) << "it is being played";
  EXPECT_EQ(book.Push("a", {1, 6, kVersion}), Verdict::kAccepted);
}

TEST(LaneLedger, AnUnknownActorMustJoin) {
  Book book(1);
  EXPECT_THAT(book.ledger.GetPermits("stranger", {}, kAll, absl::InfiniteDuration()),
              StatusIs(absl::StatusCode::kAborted, AllOf(HasSubstr("stranger"), HasSubstr("join again"))));
}

TEST(LaneLedger, LeaveFreesLanesForOthers) {
  Book book(2);
  EXPECT_THAT(book.Enter("a"), SizeIs(2));
  EXPECT_THAT(book.Enter("b"), IsEmpty());
  book.ledger.Leave("a");
  EXPECT_THAT(Lanes(book.Ask("b").granted), ElementsAre(0, 1));
  EXPECT_THAT(book.ledger.GetPermits("a", {}, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("a")));
}

TEST(LaneLedger, ALapsedLeaseFreesLanes) {
  Book book(2);
  const std::vector<Permit> of_a = book.Enter("a");
  book.ledger.Join("b", "");
  book.clock.Advance(absl::Seconds(5));
  EXPECT_THAT(book.Ask("b").granted, IsEmpty()) << "not over yet";
  book.clock.Advance(absl::Milliseconds(1));
  EXPECT_THAT(book.Ask("b").granted, SizeIs(2));
  EXPECT_EQ(book.Push("a", of_a[0]), Verdict::kExpired);
  EXPECT_THAT(book.ledger.GetPermits("a", of_a, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("join")));
}

// The design's numbers: an actor that was stopped for 4 s keeps its lanes, one stopped for 15 s learns that it lost
// them.
TEST(LaneLedger, SlowIsNotDead) {
  Book book(2);
  const std::vector<Permit> of_a = book.Enter("a");
  book.ledger.Join("b", "");
  book.clock.Advance(absl::Seconds(4));
  EXPECT_THAT(book.Ask("b").granted, IsEmpty());
  EXPECT_THAT(book.Ask("a", of_a).lost, IsEmpty());
  EXPECT_EQ(book.ledger.lapsed(), 0);
  for (int i = 0; i < 15; ++i) {
    book.clock.Advance(absl::Seconds(1));
    book.Ask("b", {});
  }
  EXPECT_EQ(book.ledger.lapsed(), 2);
  EXPECT_THAT(book.ledger.GetPermits("a", of_a, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("join again")));
  book.ledger.Join("a", "");
  EXPECT_EQ(book.Ask("a", of_a).lost, of_a);
}

TEST(LaneLedger, ALeaseThatNobodyElseWaitsForLastsTwiceAsLong) {
  Book book(2);
  const std::vector<Permit> of_a = book.Enter("a");
  book.clock.Advance(absl::Seconds(10));
  EXPECT_THAT(book.Ask("a", of_a).lost, IsEmpty());
  book.clock.Advance(absl::Milliseconds(10001));
  EXPECT_THAT(book.ledger.GetPermits("a", of_a, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("join again")));
  EXPECT_EQ(book.ledger.lapsed(), 2);
}

TEST(LaneLedger, ABrokenConnectionEndsTheLeaseSooner) {
  Book book(2);
  book.Enter("a");
  book.ledger.Join("b", "");
  book.ledger.LoseTouch("a");
  book.clock.Advance(absl::Seconds(2));
  EXPECT_THAT(book.Ask("b").granted, IsEmpty()) << "it may come back";
  book.clock.Advance(absl::Milliseconds(1));
  EXPECT_THAT(book.Ask("b").granted, SizeIs(2));
  EXPECT_EQ(book.ledger.lapsed(), 2);
  book.ledger.LoseTouch("a");  // not known any more
}

TEST(LaneLedger, WhoComesBackOnANewConnectionKeepsItsLease) {
  Book book(2);
  const std::vector<Permit> of_a = book.Enter("a");
  book.ledger.Join("b", "");
  book.ledger.LoseTouch("a");
  book.clock.Advance(absl::Milliseconds(1900));
  EXPECT_THAT(book.Ask("a", of_a).lost, IsEmpty());
  book.clock.Advance(absl::Seconds(4));
  EXPECT_THAT(book.Ask("b").granted, IsEmpty());
}

TEST(LaneLedger, ABrokenConnectionDoesNotLengthenALease) {
  Book book(2);
  book.Enter("a");
  book.ledger.Join("b", "");
  book.clock.Advance(absl::Milliseconds(4500));
  book.ledger.LoseTouch("a");
  book.clock.Advance(absl::Milliseconds(501));
  EXPECT_THAT(book.Ask("b").granted, SizeIs(2));
}

TEST(LaneLedger, WhoLeavesWhileItWaitsIsToldSo) {
  Book book(1, 0);
  book.ledger.Join("a", "");
  absl::Status status;
  std::thread waiting([&] { status = book.ledger.GetPermits("a", {}, kAll, absl::InfiniteDuration()).status(); });
  book.ledger.Leave("a");
  waiting.join();
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kAborted, HasSubstr("join again")));
}

TEST(LaneLedger, ARestartedActorIsNotItsFormerSelf) {
  Book book(2);
  const std::vector<Permit> of_old = book.Enter("host-1-aaaa");
  ASSERT_THAT(of_old, SizeIs(2));
  EXPECT_THAT(book.Enter("host-1-bbbb"), IsEmpty()) << "the permits of the other one are still out";
  EXPECT_EQ(book.Ask("host-1-bbbb", of_old).lost, of_old) << "they are not its own";
  EXPECT_EQ(book.Push("host-1-bbbb", of_old[0]), Verdict::kExpired);
  book.clock.Advance(absl::Milliseconds(5001));
  const std::vector<Permit> of_new = book.Ask("host-1-bbbb").granted;
  EXPECT_EQ(of_new, of_old);
  EXPECT_EQ(book.Push("host-1-aaaa", of_old[0]), Verdict::kExpired) << "a late fragment of the former self";
  EXPECT_THAT(book.ledger.GetPermits("host-1-aaaa", of_old, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("join again")))
      << "a late heartbeat";
  EXPECT_EQ(book.Push("host-1-bbbb", of_new[0]), Verdict::kAccepted);
}

// What bounds the ledger: actors that crash at once after joining, again and again, under new names.
TEST(LaneLedger, WhoJoinsAndVanishesIsForgotten) {
  Book book(2);
  for (int i = 0; i < 1000; ++i) {
    book.ledger.Join(std::to_string(i), "");
    book.clock.Advance(absl::Seconds(1));
  }
  EXPECT_LE(book.ledger.Actors().size(), 6);
}

TEST(LaneLedger, AskingRenewsTheLease) {
  Book book(2);
  const std::vector<Permit> of_a = book.Enter("a");
  for (int i = 0; i < 5; ++i) {
    book.clock.Advance(absl::Seconds(4));
    EXPECT_THAT(book.Ask("a", of_a).lost, IsEmpty());
  }
  EXPECT_EQ(book.Push("a", of_a[0]), Verdict::kAccepted);
}

TEST(LaneLedger, AnAcceptedFragmentRenewsTheLease) {
  Book book(2);
  const std::vector<Permit> of_a = book.Enter("a");
  book.clock.Advance(absl::Seconds(4));
  EXPECT_EQ(book.Push("a", of_a[0]), Verdict::kAccepted);
  book.clock.Advance(absl::Seconds(4));
  EXPECT_THAT(book.Enter("b"), IsEmpty());
  EXPECT_EQ(book.Push("a", of_a[1]), Verdict::kAccepted);
}

TEST(LaneLedger, TellsWhichPermitsAreLost) {
  Book book(3, 2);
  const std::vector<Permit> of_a = book.Enter("a");
  EXPECT_EQ(book.Push("a", of_a[0]), Verdict::kAccepted);
  book.clock.Advance(absl::Seconds(6));
  EXPECT_THAT(book.Enter("b", 2), SizeIs(2));  // lanes 0 and 1
  book.ledger.Join("a", "");
  const Permit nonsense = {17, 0, kVersion};
  const LaneLedger::Grant grant = book.Ask("a", {of_a[0], of_a[1], of_a[2], nonsense});
  // Lane 0's was accepted: its verdict is on the way. Lane 2 is nobody's.
  EXPECT_THAT(grant.lost, ElementsAre(of_a[1], of_a[2], nonsense));
  EXPECT_THAT(Lanes(grant.granted), ElementsAre(2));
}

TEST(LaneLedger, APermitThatIsNotNamedIsTakenBack) {
  Book book(2);
  const std::vector<Permit> of_a = book.Enter("a");
  EXPECT_THAT(book.Ask("a", {of_a[0]}).granted, ElementsAre(of_a[1]));
  book.Ask("a", {of_a[1]}, 1);
  EXPECT_EQ(book.Push("a", of_a[0]), Verdict::kExpired);
  EXPECT_EQ(book.Push("a", of_a[1]), Verdict::kAccepted);
}

// Its environment servers may be out of its reach: without this it would get the same lanes for ever.
TEST(LaneLedger, WhatAnActorGivesBackOthersGetFirst) {
  Book book(4);
  book.ledger.Join("a", "");
  const std::vector<Permit> of_b = book.Enter("b");
  ASSERT_THAT(of_b, SizeIs(2));
  ASSERT_THAT(book.Ask("a").granted, SizeIs(2));
  EXPECT_THAT(book.Ask("a", {}).granted, IsEmpty());
  for (const Permit& permit : of_b) EXPECT_EQ(book.Push("b", permit), Verdict::kAccepted);
  book.clock.Advance(absl::Milliseconds(500));
  EXPECT_THAT(book.Ask("a", {}).granted, IsEmpty());
  book.clock.Advance(absl::Milliseconds(501));
  EXPECT_THAT(Lanes(book.Ask("b").granted), ElementsAre(2, 3));
}

TEST(LaneLedger, WhatNobodyElseTookComesBackToTheOneWhoGaveIt) {
  Book book(4);
  book.ledger.Join("b", "");
  const std::vector<Permit> of_a = book.Enter("a");
  EXPECT_THAT(book.Ask("a", {}).granted, IsEmpty());
  book.clock.Advance(absl::Milliseconds(1001));
  EXPECT_EQ(book.Ask("a", {}).granted, of_a);
}

TEST(LaneLedger, AcceptsAFragmentOnce) {
  Book book(2);
  const std::vector<Permit> of_a = book.Enter("a");
  EXPECT_EQ(book.Push("a", of_a[0]), Verdict::kAccepted);
  EXPECT_EQ(book.Push("a", of_a[0]), Verdict::kDuplicate);
  EXPECT_EQ(book.Push("b", of_a[0]), Verdict::kDuplicate);
  EXPECT_EQ(book.ledger.Records()[0].next_fragment, 1);
}

TEST(LaneLedger, RefusesFragmentsWithoutPermit) {
  Book book(2, 2);
  const std::vector<Permit> of_a = book.Enter("a", 1);
  EXPECT_EQ(book.Push("b", of_a[0]), Verdict::kExpired) << "another's permit";
  EXPECT_EQ(book.Push("a", {1, 0, kVersion}), Verdict::kExpired) << "no permit is out";
  EXPECT_EQ(book.Push("a", {0, 1, kVersion}), Verdict::kExpired) << "the fragment after the permitted one";
  EXPECT_EQ(book.ledger.Records()[0].next_fragment, 0);
  EXPECT_EQ(book.ledger.Records()[1].next_fragment, 0);
}

TEST(LaneLedger, RefusesFragmentsOfOtherWeights) {
  Book book(1);
  const Permit permit = book.Enter("a")[0];
  EXPECT_THAT(book.ledger.Accept("a", {0, 0, kVersion - 1}, {"s", {}}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("policy_version 19"), HasSubstr("lane 0"), HasSubstr("want 20"))));
  EXPECT_EQ(book.Push("a", permit), Verdict::kAccepted) << "the permit still stands";
}

TEST(LaneLedger, KeepsTheSnapshotOfTheLastAcceptedFragment) {
  Book book({{3, {"before 3", {0.5F}}}}, 5);
  const Permit permit = book.Enter("a")[0];
  EXPECT_EQ(book.ledger.Snapshot(0, 3).value(), (LaneSnapshot{"before 3", {0.5F}}));
  EXPECT_EQ(book.Push("a", permit), Verdict::kAccepted);
  EXPECT_EQ(book.Push("a", permit), Verdict::kDuplicate);
  EXPECT_EQ(book.ledger.Snapshot(0, 4).value(), (LaneSnapshot{"after 3", {1.5F}}));
  EXPECT_EQ(book.ledger.Records()[0].snapshot, (LaneSnapshot{"after 3", {1.5F}}));
  EXPECT_THAT(book.ledger.Snapshot(0, 3),
              StatusIs(absl::StatusCode::kAborted, HasSubstr("lane 0 is at fragment 4, not 3")));
  for (const int lane : {-1, 1}) {
    EXPECT_THAT(book.ledger.Snapshot(lane, 0), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("want 0..0")));
  }
}

TEST(LaneLedger, ALaneLeftLyingGoesToAnybodyAfterAWhile) {
  Book book(4);
  book.ledger.Join("slow", "");
  const std::vector<Permit> of_fast = book.Enter("fast");
  ASSERT_THAT(of_fast, SizeIs(2));
  for (const Permit& permit : of_fast) EXPECT_EQ(book.Push("fast", permit), Verdict::kAccepted);
  EXPECT_THAT(book.Ask("fast").granted, IsEmpty()) << "the rest is the other's share";
  book.clock.Advance(absl::Milliseconds(1001));
  EXPECT_THAT(book.Ask("fast").granted, SizeIs(2));
}

TEST(LaneLedger, TellsThatTheRunIsOver) {
  Book book(1);
  const std::vector<Permit> of_a = book.Enter("a");
  EXPECT_FALSE(book.Ask("a", of_a).finished);
  std::thread waiting(
      [&] { EXPECT_TRUE(book.ledger.GetPermits("a", of_a, kAll, absl::InfiniteDuration())->finished); });
  book.ledger.Finish();
  waiting.join();
  std::thread leaving([&] { book.ledger.Leave("a"); });
  book.ledger.WaitUntilEmpty(absl::InfiniteDuration());
  leaving.join();
  EXPECT_THAT(book.ledger.Actors(), IsEmpty());
}

TEST(LaneLedger, CloseWakesThoseWhoWaitAndGrantsNothing) {
  Book book(1, 0);
  book.ledger.Join("a", "");
  absl::Status status;
  std::thread waiting([&] { status = book.ledger.GetPermits("a", {}, kAll, absl::InfiniteDuration()).status(); });
  book.ledger.Close();
  waiting.join();
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kUnavailable, HasSubstr("is stopping")));
  book.ledger.OpenIteration(1, kVersion);
  EXPECT_THAT(book.ledger.GetPermits("a", {}, kAll, absl::ZeroDuration()),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("is stopping")));
}

TEST(LaneLedger, ANewIterationWakesThoseWhoWait) {
  Book book(1, 0);
  book.ledger.Join("a", "");
  std::vector<Permit> granted;
  std::thread waiting([&] { granted = book.ledger.GetPermits("a", {}, kAll, absl::InfiniteDuration())->granted; });
  book.ledger.OpenIteration(1, kVersion);
  waiting.join();
  EXPECT_THAT(granted, ElementsAre(Permit{0, 0, kVersion}));
}

TEST(LaneLedger, TellsAboutActors) {
  Book book(3, 2);
  const std::vector<Permit> of_a = book.Enter("a", 2);
  book.Push("a", of_a[0]);
  book.clock.Advance(absl::Seconds(2));
  book.ledger.Join("b", "10.0.0.2:7");
  const std::vector<LaneLedger::ActorInfo> actors = book.ledger.Actors();
  ASSERT_THAT(actors, SizeIs(2));
  EXPECT_EQ(actors[0].name, "a");
  EXPECT_EQ(actors[0].address, "address of a");
  EXPECT_EQ(actors[0].permits, 1);
  EXPECT_EQ(actors[0].fragments, 1);
  EXPECT_EQ(actors[0].idle, absl::Seconds(2));
  EXPECT_EQ(actors[1].address, "10.0.0.2:7");
  EXPECT_EQ(actors[1].permits, 0);
}

}  // namespace
}  // namespace craftfleet
