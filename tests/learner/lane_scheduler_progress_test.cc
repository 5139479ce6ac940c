// Progress keeps permits: an actor that only sends requests loses them, so that no fragment waits for it.
#include <algorithm>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/test_registry.h"

namespace craftfleet {
namespace {

using testing::ElementsAreArray;
using testing::IsEmpty;
using testing::SizeIs;

using Verdict = LaneScheduler::Verdict;

constexpr int64_t kVersion = 3;

class ProgressTest : public testing::Test {
 protected:
  void SetUp() override { registry_.OpenIteration(10000, kVersion); }

  // `steps`: steps played of each of `active`.
  TestRegistry::Grant Ask(const std::string& actor, const std::vector<Permit>& active = {}, int64_t steps = 0,
                          int capacity = 100) {
    const std::vector<int64_t> played(active.size(), steps);
    const auto grant = registry_.GetPermits(actor, active, capacity, absl::ZeroDuration(), played);
    EXPECT_THAT(grant, IsOk());
    return grant.value_or(TestRegistry::Grant());
  }
  Verdict Push(const std::string& actor, const Permit& permit) {
    return registry_.Accept(actor, permit, {"after", {}}).value_or(Verdict::kExpired);
  }
  // Both actors send requests every second and report their permits, without progress beyond `steps`.
  void Wait(int seconds, const std::string& a, const std::vector<Permit>& of_a, int64_t steps_a, const std::string& b,
            const std::vector<Permit>& of_b, int64_t steps_b) {
    for (int i = 0; i < seconds; ++i) {
      clock_.Advance(absl::Seconds(1));
      Ask(a, of_a, steps_a);
      Ask(b, of_b, steps_b);
    }
  }
  bool IsStalled(const std::string& name) const {
    for (const LaneScheduler::ActorInfo& actor : registry_.Actors()) {
      if (actor.name == name) return actor.stalled;
    }
    return false;
  }

  FakeClock clock_;
  TestRegistry registry_{
      {4, absl::Seconds(5), absl::Seconds(1), absl::Seconds(2)}, std::vector<LaneRecord>(4), &clock_};
};

// With a silent environment server, an actor sends requests but plays nothing.
TEST_F(ProgressTest, AStalledPermitGoesToAnotherActor) {
  registry_.Join("stuck", "");
  registry_.Join("good", "");
  const std::vector<Permit> of_stuck = Ask("stuck").granted;
  const std::vector<Permit> of_good = Ask("good").granted;
  ASSERT_THAT(of_stuck, SizeIs(2));
  for (int second = 1; second <= 21; ++second) {
    clock_.Advance(absl::Seconds(1));
    ASSERT_THAT(Ask("stuck", of_stuck, 7).lost, IsEmpty()) << second << ": the first report of 7 was progress";
    Ask("good", of_good, second);
  }
  clock_.Advance(absl::Milliseconds(1));
  EXPECT_THAT(Ask("stuck", of_stuck, 7).lost, ElementsAreArray(of_stuck));
  EXPECT_EQ(registry_.lapsed(), 2);
  EXPECT_TRUE(IsStalled("stuck"));
  EXPECT_FALSE(IsStalled("good"));
  EXPECT_THAT(Ask("good", of_good, 22).granted, SizeIs(1))
      << "in addition to its own two: the other actor counts as having a capacity of one lane";
}

TEST_F(ProgressTest, SteadyProgressKeepsAPermit) {
  registry_.Join("slow", "");
  registry_.Join("good", "");
  const std::vector<Permit> of_slow = Ask("slow").granted;
  for (int step = 1; step <= 30; ++step) {
    for (int i = 0; i < 5; ++i) {
      clock_.Advance(absl::Milliseconds(3800));
      EXPECT_THAT(Ask("slow", of_slow, step).lost, IsEmpty());
      Ask("good");
    }
  }
  EXPECT_EQ(registry_.lapsed(), 0);
  EXPECT_EQ(Push("slow", of_slow[0]), Verdict::kAccepted);
}

TEST_F(ProgressTest, ARestartedGameMakesProgress) {
  registry_.Join("moved", "");
  registry_.Join("good", "");
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

TEST_F(ProgressTest, ALoneActorKeepsItsPermits) {
  registry_.Join("a", "");
  const std::vector<Permit> permits = Ask("a").granted;
  ASSERT_THAT(permits, SizeIs(4));
  for (int i = 0; i < 1000; ++i) {
    clock_.Advance(absl::Seconds(4));
    ASSERT_THAT(Ask("a", permits, 0).lost, IsEmpty());
  }
  EXPECT_EQ(registry_.lapsed(), 0);
}

// Two actors on one lane, each of which needs a minute for the first step: the patience doubles until one finishes.
TEST_F(ProgressTest, PatienceDoublesWithEachFailureInARow) {
  FakeClock clock;
  TestRegistry registry({1}, std::vector<LaneRecord>(1), &clock);
  registry.OpenIteration(1, kVersion);
  registry.Join("a", "");
  registry.Join("b", "");
  const Permit permit{0, 0, kVersion};
  std::map<std::string, int> since;  // when each player got the lane, in seconds; one may be the other's backup
  std::vector<int> held;             // how long revoked permits were held, in seconds
  for (int second = 0; second < 300; ++second) {
    for (const std::string name : {"a", "b"}) {
      const std::vector<Permit> active = since.count(name) > 0 ? std::vector<Permit>{permit} : std::vector<Permit>();
      const TestRegistry::Grant grant = *registry.GetPermits(name, active, 1, absl::ZeroDuration(), {0});
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

TEST_F(ProgressTest, AStalledActorPausesLongerEachTimeAndRecovers) {
  registry_.Join("stuck", "");
  registry_.Join("good", "");
  std::vector<Permit> of_good = Ask("good").granted;
  std::vector<Permit> of_stuck = Ask("stuck").granted;
  ASSERT_THAT(of_stuck, SizeIs(2));
  Wait(21, "stuck", of_stuck, 0, "good", of_good, 21);
  EXPECT_TRUE(IsStalled("stuck"));
  // "good" continues within its capacity; "stuck" gets one lane to try.
  size_t most = 0;
  std::vector<Permit> tried;
  for (int second = 0; second < 600; ++second) {
    clock_.Advance(absl::Seconds(1));
    for (const Permit& permit : of_good) EXPECT_EQ(Push("good", permit), Verdict::kAccepted);
    of_good = Ask("good").granted;
    if (!tried.empty() && registry_.Records()[tried[0].lane].next_fragment > tried[0].fragment) tried.clear();
    const TestRegistry::Grant grant = Ask("stuck", tried, 0);
    if (!grant.lost.empty()) tried.clear();
    tried.insert(tried.end(), grant.granted.begin(), grant.granted.end());
    most = std::max(most, tried.size());
    if (second > 100 && !tried.empty()) break;
  }
  EXPECT_EQ(most, 1) << "it gets one permit at a time";
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

// No permit lapsed and no actor was lost: one of two actors is just far slower than the other.
TEST_F(ProgressTest, AnOverdueFragmentGetsABackup) {
  registry_.OpenIteration(1, kVersion);
  registry_.Join("slow", "");
  registry_.Join("good", "");
  const std::vector<Permit> of_slow = Ask("slow").granted;
  const std::vector<Permit> of_good = Ask("good").granted;
  clock_.Advance(absl::Seconds(1));
  for (const Permit& permit : of_good) ASSERT_EQ(Push("good", permit), Verdict::kAccepted);
  // Overdue after twice the patience plus four times the median: 2 s + 4 s.
  for (int second = 2; second <= 6; ++second) {
    clock_.Advance(absl::Seconds(1));
    Ask("slow", of_slow, second);
    ASSERT_THAT(Ask("good").granted, IsEmpty()) << second;
  }
  clock_.Advance(absl::Milliseconds(1));
  EXPECT_THAT(Ask("good").granted, ElementsAreArray(of_slow));
  EXPECT_EQ(registry_.lapsed(), 0);
  EXPECT_EQ(Push("good", of_slow[0]), Verdict::kAccepted);
  EXPECT_EQ(Push("slow", of_slow[0]), Verdict::kDuplicate);
}

TEST_F(ProgressTest, AStalledBackupIsReplaced) {
  registry_.OpenIteration(1, kVersion);
  for (const char* name : {"slow", "stuck"}) registry_.Join(name, "");
  const std::vector<Permit> of_slow = Ask("slow").granted;
  for (const Permit& permit : Ask("stuck").granted) ASSERT_EQ(Push("stuck", permit), Verdict::kAccepted);
  clock_.Advance(absl::Milliseconds(2001));
  Ask("slow", of_slow, 1);
  ASSERT_THAT(Ask("stuck").granted, ElementsAreArray(of_slow));
  registry_.Join("third", "");
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

// The system date is set forward and back by an hour.
TEST_F(ProgressTest, SettingTheDateChangesNoLease) {
  registry_.Join("a", "");
  registry_.Join("b", "");
  const std::vector<Permit> of_a = Ask("a").granted;
  for (const absl::Duration ahead : {absl::Hours(1), -absl::Hours(1), absl::ZeroDuration()}) {
    clock_.SetWallAhead(ahead);
    EXPECT_THAT(Ask("a", of_a, 1).lost, IsEmpty());
    EXPECT_THAT(Ask("b").lost, IsEmpty());
  }
  EXPECT_EQ(registry_.lapsed(), 0);
  clock_.SetWallAhead(-absl::Hours(1));
  clock_.Advance(absl::Milliseconds(5001));
  Ask("b");
  EXPECT_EQ(registry_.lapsed(), static_cast<int64_t>(of_a.size())) << "nor does it prolong a lease";
}

}  // namespace
}  // namespace craftfleet
