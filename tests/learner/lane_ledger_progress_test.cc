// Permits stay with actors that get on with them: one that merely speaks loses them, and no fragment waits for it.
#include <algorithm>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "learner/lane_ledger.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::ElementsAreArray;
using testing::IsEmpty;
using testing::SizeIs;

using Verdict = LaneLedger::Verdict;

constexpr int64_t kVersion = 3;

class ProgressTest : public testing::Test {
 protected:
  void SetUp() override { ledger_.OpenIteration(10000, kVersion); }

  // `steps`: played of each of `active`.
  LaneLedger::Grant Ask(const std::string& actor, const std::vector<Permit>& active = {}, int64_t steps = 0,
                        int capacity = 100) {
    const std::vector<int64_t> played(active.size(), steps);
    const auto grant = ledger_.GetPermits(actor, active, capacity, absl::ZeroDuration(), played);
    EXPECT_THAT(grant, IsOk());
    return grant.value_or(LaneLedger::Grant());
  }
  Verdict Push(const std::string& actor, const Permit& permit) {
    return ledger_.Accept(actor, permit, {"after", {}}).value_or(Verdict::kExpired);
  }
  // Each of the two asks every second and holds what it has; neither makes progress beyond `steps`.
  void Wait(int seconds, const std::string& a, const std::vector<Permit>& of_a, int64_t steps_a, const std::string& b,
            const std::vector<Permit>& of_b, int64_t steps_b) {
    for (int i = 0; i < seconds; ++i) {
      clock_.Advance(absl::Seconds(1));
      Ask(a, of_a, steps_a);
      Ask(b, of_b, steps_b);
    }
  }
  bool IsStalled(const std::string& name) const {
    for (const LaneLedger::ActorInfo& actor : ledger_.Actors()) {
      if (actor.name == name) return actor.stalled;
    }
    return false;
  }

  FakeClock clock_;
  LaneLedger ledger_{{4, absl::Seconds(5), absl::Seconds(1), absl::Seconds(2)}, std::vector<LaneRecord>(4), &clock_};
};

// The silent environment server: its actor lives, asks and plays nothing.
TEST_F(ProgressTest, WhatMakesNoProgressGoesToAnother) {
  ledger_.Join("stuck", "");
  ledger_.Join("good", "");
  const std::vector<Permit> of_stuck = Ask("stuck").granted;
  const std::vector<Permit> of_good = Ask("good").granted;
  ASSERT_THAT(of_stuck, SizeIs(2));
  for (int second = 1; second <= 21; ++second) {
    clock_.Advance(absl::Seconds(1));
    ASSERT_THAT(Ask("stuck", of_stuck, 7).lost, IsEmpty()) << second << ": the first word of 7 was progress";
    Ask("good", of_good, second);
  }
  clock_.Advance(absl::Milliseconds(1));
  EXPECT_THAT(Ask("stuck", of_stuck, 7).lost, ElementsAreArray(of_stuck));
  EXPECT_EQ(ledger_.lapsed(), 2);
  EXPECT_TRUE(IsStalled("stuck"));
  EXPECT_FALSE(IsStalled("good"));
  EXPECT_THAT(Ask("good", of_good, 22).granted, SizeIs(1))
      << "beside its own two: the other counts as one that can play a single lane";
}

TEST_F(ProgressTest, AnySteadyProgressKeepsAPermit) {
  ledger_.Join("slow", "");
  ledger_.Join("good", "");
  const std::vector<Permit> of_slow = Ask("slow").granted;
  for (int step = 1; step <= 30; ++step) {
    for (int i = 0; i < 5; ++i) {
      clock_.Advance(absl::Milliseconds(3800));
      EXPECT_THAT(Ask("slow", of_slow, step).lost, IsEmpty());
      Ask("good");
    }
  }
  EXPECT_EQ(ledger_.lapsed(), 0);
  EXPECT_EQ(Push("slow", of_slow[0]), Verdict::kAccepted);
}

TEST_F(ProgressTest, AGameThatBeginsAgainMakesProgress) {
  ledger_.Join("moved", "");
  ledger_.Join("good", "");
  const std::vector<Permit> permits = Ask("moved").granted;
  Ask("moved", permits, 100);
  for (int64_t steps = 0; steps < 5; ++steps) {
    for (int i = 0; i < 4; ++i) {
      clock_.Advance(absl::Seconds(4));
      Ask("good");
      EXPECT_THAT(Ask("moved", permits, steps).lost, IsEmpty()) << "100 steps, then " << steps;
    }
  }
}

TEST_F(ProgressTest, AnActorAloneKeepsWhatItHas) {
  ledger_.Join("a", "");
  const std::vector<Permit> permits = Ask("a").granted;
  ASSERT_THAT(permits, SizeIs(4));
  for (int i = 0; i < 1000; ++i) {
    clock_.Advance(absl::Seconds(4));
    ASSERT_THAT(Ask("a", permits, 0).lost, IsEmpty());
  }
  EXPECT_EQ(ledger_.lapsed(), 0);
}

// Two on one lane, each of which takes a minute for the first step: the lane's patience doubles until one gets done.
TEST_F(ProgressTest, PatienceDoublesWithEachFailureInARow) {
  FakeClock clock;
  LaneLedger ledger({1}, std::vector<LaneRecord>(1), &clock);
  ledger.OpenIteration(1, kVersion);
  ledger.Join("a", "");
  ledger.Join("b", "");
  const Permit permit{0, 0, kVersion};
  std::map<std::string, int> since;  // seconds, of who has it: both may, one as the other's backup
  std::vector<int> held;             // seconds, of those that were taken back
  for (int second = 0; second < 300; ++second) {
    for (const std::string name : {"a", "b"}) {
      const std::vector<Permit> active = since.count(name) > 0 ? std::vector<Permit>{permit} : std::vector<Permit>();
      const LaneLedger::Grant grant = *ledger.GetPermits(name, active, 1, absl::ZeroDuration(), {0});
      if (!grant.lost.empty()) {
        held.push_back(second - since[name]);
        since.erase(name);
      }
      if (!grant.granted.empty()) since[name] = second;
    }
    clock.Advance(absl::Seconds(1));
  }
  ASSERT_GE(held.size(), 3);
  EXPECT_NEAR(held[0], 20, 2);
  EXPECT_NEAR(held[1], 40, 2);
  EXPECT_NEAR(held[2], 80, 2);
}

TEST_F(ProgressTest, WhoMakesNoProgressPausesLongerAndLongerAndComesBack) {
  ledger_.Join("stuck", "");
  ledger_.Join("good", "");
  std::vector<Permit> of_good = Ask("good").granted;
  std::vector<Permit> of_stuck = Ask("stuck").granted;
  ASSERT_THAT(of_stuck, SizeIs(2));
  Wait(21, "stuck", of_stuck, 0, "good", of_good, 21);
  EXPECT_TRUE(IsStalled("stuck"));
  // The good one plays on and never has more than it can; the stuck one is given one lane to try.
  size_t most = 0;
  std::vector<Permit> tried;
  for (int second = 0; second < 600; ++second) {
    clock_.Advance(absl::Seconds(1));
    for (const Permit& permit : of_good) EXPECT_EQ(Push("good", permit), Verdict::kAccepted);
    of_good = Ask("good").granted;
    if (!tried.empty() && ledger_.Records()[tried[0].lane].next_fragment > tried[0].fragment) tried.clear();
    const LaneLedger::Grant grant = Ask("stuck", tried, 0);
    if (!grant.lost.empty()) tried.clear();
    tried.insert(tried.end(), grant.granted.begin(), grant.granted.end());
    most = std::max(most, tried.size());
    if (second > 100 && !tried.empty()) break;
  }
  EXPECT_EQ(most, 1) << "it is tried, with one permit at a time";
  ASSERT_THAT(tried, SizeIs(1));
  Ask("stuck", tried, 1);
  EXPECT_FALSE(IsStalled("stuck"));
  EXPECT_EQ(Push("stuck", tried[0]), Verdict::kAccepted);
  // Its share moves back to it with the next fragments.
  size_t share = 0;
  for (int second = 0; second < 5 && share < 2; ++second) {
    clock_.Advance(absl::Seconds(1));
    for (const Permit& permit : of_good) Push("good", permit);
    const std::vector<Permit> granted = Ask("stuck").granted;
    share = granted.size();
    for (const Permit& permit : granted) EXPECT_EQ(Push("stuck", permit), Verdict::kAccepted);
    of_good = Ask("good").granted;
  }
  EXPECT_EQ(share, 2);
}

// Nothing lapsed, nobody died: one of two is just far slower than the other.
TEST_F(ProgressTest, AFragmentThatIsOverdueGetsASecondPlayer) {
  ledger_.OpenIteration(1, kVersion);
  ledger_.Join("slow", "");
  ledger_.Join("good", "");
  const std::vector<Permit> of_slow = Ask("slow").granted;
  const std::vector<Permit> of_good = Ask("good").granted;
  clock_.Advance(absl::Seconds(1));
  for (const Permit& permit : of_good) ASSERT_EQ(Push("good", permit), Verdict::kAccepted);
  // Overdue: twice the patience and four times the median, 2 s + 4 s.
  for (int second = 2; second <= 6; ++second) {
    clock_.Advance(absl::Seconds(1));
    Ask("slow", of_slow, second);
    ASSERT_THAT(Ask("good").granted, IsEmpty()) << second;
  }
  clock_.Advance(absl::Milliseconds(1));
  EXPECT_THAT(Ask("good").granted, ElementsAreArray(of_slow));
  EXPECT_EQ(ledger_.lapsed(), 0);
  EXPECT_EQ(Push("good", of_slow[0]), Verdict::kAccepted);
  EXPECT_EQ(Push("slow", of_slow[0]), Verdict::kDuplicate);
}

TEST_F(ProgressTest, ABackupThatMakesNoProgressMakesRoomForAnother) {
  ledger_.OpenIteration(1, kVersion);
  for (const char* name : {"slow", "stuck"}) ledger_.Join(name, "");
  const std::vector<Permit> of_slow = Ask("slow").granted;
  for (const Permit& permit : Ask("stuck").granted) ASSERT_EQ(Push("stuck", permit), Verdict::kAccepted);
  clock_.Advance(absl::Milliseconds(2001));
  Ask("slow", of_slow, 1);
  ASSERT_THAT(Ask("stuck").granted, ElementsAreArray(of_slow));
  ledger_.Join("third", "");
  for (int second = 0; second < 21; ++second) {
    clock_.Advance(absl::Seconds(1));
    Ask("slow", of_slow, 2 + second);
    Ask("stuck", of_slow, 0);
    if (second < 20) {
      ASSERT_THAT(Ask("third").granted, IsEmpty());
    }
  }
  EXPECT_THAT(Ask("third").granted, ElementsAreArray(of_slow));
  EXPECT_EQ(Push("slow", of_slow[0]), Verdict::kAccepted);
}

// The date is set forwards and back by an hour.
TEST_F(ProgressTest, TheDateChangesNoLease) {
  ledger_.Join("a", "");
  ledger_.Join("b", "");
  const std::vector<Permit> of_a = Ask("a").granted;
  for (const absl::Duration ahead : {absl::Hours(1), -absl::Hours(1), absl::ZeroDuration()}) {
    clock_.SetWallAhead(ahead);
    EXPECT_THAT(Ask("a", of_a, 1).lost, IsEmpty());
    EXPECT_THAT(Ask("b").lost, IsEmpty());
  }
  EXPECT_EQ(ledger_.lapsed(), 0);
  clock_.SetWallAhead(-absl::Hours(1));
  clock_.Advance(absl::Milliseconds(5001));
  Ask("b");
  EXPECT_EQ(ledger_.lapsed(), static_cast<int64_t>(of_a.size())) << "nor does it keep one alive";
}

}  // namespace
}  // namespace craftfleet
