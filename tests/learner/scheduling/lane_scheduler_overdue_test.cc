// Overdue fragments: whatever their players report, idle actors play them too, and the first result counts.
#include <algorithm>
#include <cstdint>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace lane_scheduler_overdue_test {

using testing::AllOf;
using testing::ElementsAreArray;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;

using Verdict = LaneScheduler::Verdict;

constexpr int64_t kVersion = 3;
constexpr absl::Duration kTick = absl::Milliseconds(1);

// Four lanes; a fragment is overdue after 3 s.
class OverdueLanes : public testing::Test {
 protected:
  void SetUp() override { registry_.OpenIteration(1, kVersion); }

  void Join(const std::string& actor, const std::string& client = "") {
    ASSERT_THAT(registry_.WorkerRegistry::Join({client}, actor, "", {}), IsOk());
    clients_[actor] = client;
  }
  TestRegistry::Grant Ask(const std::string& actor, const std::vector<Permit>& active = {}, int capacity = 100) {
    WorkerRegistry::PermitRequest request = TestRegistry::RequestOf(actor, active, capacity);
    request.client.identity = clients_[actor];
    const auto grant = registry_.GetPermits(request);
    EXPECT_THAT(grant, IsOk());
    return grant.value_or(TestRegistry::Grant());
  }
  Verdict Push(const std::string& actor, const Permit& permit) {
    return registry_.Accept(actor, permit, {"after", {}}).value_or(Verdict::kExpired);
  }
  // "slow" and "good" get two lanes each; "good" plays its lanes at once. Then those of "slow" become overdue, while it
  // reports them.
  void FinishGood(const std::string& client_of_good = "", const std::string& client_of_slow = "") {
    Join("slow", client_of_slow);
    Join("good", client_of_good);
    of_slow_ = Ask("slow").granted;
    const std::vector<Permit> of_good = Ask("good").granted;
    ASSERT_THAT(of_slow_, SizeIs(2));
    ASSERT_THAT(of_good, SizeIs(2));
    clock_.Advance(kTick);
    for (const Permit& permit : of_good) ASSERT_EQ(Push("good", permit), Verdict::kAccepted);
    Pass(absl::Seconds(3) - kTick, {"slow"}, of_slow_);
  }
  // Time passes, in which `actors` report `active`, and `idle` that it can play nothing.
  void Pass(absl::Duration time, const std::vector<std::string>& actors, const std::vector<Permit>& active,
            const std::string& idle = "") {
    for (const absl::Time end = clock_.Now() + time; clock_.Now() < end;) {
      clock_.Advance(std::min(absl::Seconds(1), end - clock_.Now()));
      for (const std::string& actor : actors) Ask(actor, active);
      if (!idle.empty()) Ask(idle, {}, 0);
    }
  }
  bool IsLate(const std::string& name) const {
    for (const LaneActor& actor : registry_.Actors()) {
      if (actor.worker->name == name) return actor.pause > absl::ZeroDuration();
    }
    return false;
  }

  FakeClock clock_;
  TestRegistry registry_{{4}, std::vector<LaneRecord>(4), &clock_};
  std::map<std::string, std::string> clients_;
  std::vector<Permit> of_slow_;
};

TEST_F(OverdueLanes, AnIdleActorPlaysThemTooAndTheFirstResultCounts) {
  FinishGood();
  EXPECT_THAT(Ask("good").granted, IsEmpty()) << "not yet overdue";
  clock_.Advance(kTick);
  EXPECT_THAT(Ask("good").granted, ElementsAreArray(of_slow_));
  EXPECT_THAT(Ask("slow", of_slow_).lost, IsEmpty()) << "it may still be first";
  EXPECT_EQ(Push("good", of_slow_[0]), Verdict::kAccepted);
  EXPECT_EQ(Push("slow", of_slow_[0]), Verdict::kDuplicate);
  EXPECT_EQ(Push("slow", of_slow_[1]), Verdict::kAccepted);
  EXPECT_EQ(Push("good", of_slow_[1]), Verdict::kDuplicate);
  EXPECT_EQ(registry_.permits(), 0);
}

// One line for all of them: a learner of 512 lanes would log hundreds at once.
TEST_F(OverdueLanes, TheirNewPlayerIsLoggedInOneLine) {
  FinishGood();
  clock_.Advance(kTick);
  testing::internal::CaptureStderr();
  ASSERT_THAT(Ask("good").granted, SizeIs(2));
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(log, HasSubstr(absl::StrCat("actor good also plays fragment 0 of lane ", of_slow_[0].lane,
                                          ", which actor slow has had for 3s, and 1 more\n")));
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 1) << log;
}

TEST_F(OverdueLanes, TheOthersAreToldWhetherTheySendOrNot) {
  FinishGood();
  clock_.Advance(kTick);
  ASSERT_THAT(Ask("good").granted, SizeIs(2));
  ASSERT_EQ(Push("good", of_slow_[0]), Verdict::kAccepted);
  EXPECT_THAT(Ask("slow", of_slow_).lost, ElementsAreArray({of_slow_[0]}));
  EXPECT_THAT(Ask("good", of_slow_).lost, IsEmpty()) << "the verdict on its fragment is on the way";
}

TEST_F(OverdueLanes, SeveralTimesTheMedianIsAllowed) {
  Join("slow");
  Join("good");
  of_slow_ = Ask("slow").granted;
  const std::vector<Permit> of_good = Ask("good").granted;
  Pass(absl::Seconds(2), {"slow"}, of_slow_);
  for (const Permit& permit : of_good) ASSERT_EQ(Push("good", permit), Verdict::kAccepted);
  Pass(absl::Seconds(6), {"slow"}, of_slow_, "good");
  EXPECT_THAT(Ask("good").granted, IsEmpty()) << "four times two seconds";
  clock_.Advance(kTick);
  EXPECT_THAT(Ask("good").granted, ElementsAreArray(of_slow_));
}

TEST_F(OverdueLanes, TheFirstFragmentsOfARunAreBoundedToo) {
  Join("stuck");
  of_slow_ = Ask("stuck").granted;
  ASSERT_THAT(of_slow_, SizeIs(4));
  Join("good");
  Pass(absl::Seconds(20), {"stuck"}, of_slow_, "good");
  EXPECT_THAT(Ask("good").granted, IsEmpty());
  clock_.Advance(kTick);
  EXPECT_THAT(Ask("good", {}).granted, SizeIs(2)) << "its share";
}

// Each of them only reports; they took the lane one after the other for ever.
TEST_F(OverdueLanes, APlayerThatIsOverdueItselfIsFollowedByAnother) {
  FinishGood();
  ASSERT_EQ(Push("slow", of_slow_[1]), Verdict::kAccepted);
  of_slow_.pop_back();
  std::vector<std::string> stuck = {"slow", "good"};
  clock_.Advance(kTick);
  ASSERT_THAT(Ask("good").granted, SizeIs(1));
  for (int i = 0; i < 5; ++i) {
    const std::string next = absl::StrCat("another ", i);
    Join(next);
    EXPECT_THAT(Ask(next).granted, IsEmpty()) << "the last player has only just got it";
    Pass(absl::Seconds(3), stuck, of_slow_);
    Ask(next);
    clock_.Advance(kTick);
    EXPECT_THAT(Ask(next).granted, Not(IsEmpty())) << i;
    stuck.push_back(next);
  }
  EXPECT_EQ(Push("another 4", of_slow_[0]), Verdict::kAccepted);
}

TEST_F(OverdueLanes, ActorsOfOtherClientsComeFirst) {
  FinishGood("honest", "stuck");
  Join("second name", "stuck");
  clock_.Advance(kTick);
  EXPECT_THAT(Ask("second name").granted, IsEmpty());
  EXPECT_THAT(Ask("good").granted, ElementsAreArray(of_slow_));
}

TEST_F(OverdueLanes, ActorsOfTheSameClientFollowIfTheOthersDoNotAsk) {
  FinishGood("honest", "stuck");
  Join("second name", "stuck");
  Pass(absl::Seconds(1), {"slow"}, of_slow_);
  EXPECT_THAT(Ask("second name").granted, IsEmpty());
  clock_.Advance(kTick);
  EXPECT_THAT(Ask("second name").granted, Not(IsEmpty()));
}

TEST_F(OverdueLanes, ABusyActorGetsNone) {
  Join("a");
  Join("b");
  const std::vector<Permit> of_a = Ask("a").granted;
  const std::vector<Permit> of_b = Ask("b").granted;
  for (int second = 0; second < 30; ++second) {
    Pass(absl::Seconds(1), {"a"}, of_a);
    EXPECT_THAT(Ask("b", of_b).granted, IsEmpty());
  }
}

TEST_F(OverdueLanes, WhenOnePlayerIsLostTheOthersContinue) {
  FinishGood();
  clock_.Advance(kTick);
  ASSERT_THAT(Ask("good").granted, SizeIs(2));
  registry_.Leave("slow");
  EXPECT_THAT(Ask("good", of_slow_).lost, IsEmpty());
  EXPECT_EQ(registry_.permits(), 2);
  for (const Permit& permit : of_slow_) EXPECT_EQ(Push("good", permit), Verdict::kAccepted);
}

TEST_F(OverdueLanes, ThePlayerThatKeepsAPermitGoesOnIfAnotherReturnsIt) {
  FinishGood();
  clock_.Advance(kTick);
  ASSERT_THAT(Ask("good").granted, SizeIs(2));
  Ask("good", {of_slow_[1]});
  EXPECT_EQ(Push("good", of_slow_[0]), Verdict::kExpired);
  EXPECT_EQ(Push("slow", of_slow_[0]), Verdict::kAccepted);
  Ask("slow", {});
  EXPECT_EQ(Push("slow", of_slow_[1]), Verdict::kExpired);
  EXPECT_EQ(Push("good", of_slow_[1]), Verdict::kAccepted);
}

TEST_F(OverdueLanes, ALoneActorKeepsItsPermits) {
  Join("a");
  const std::vector<Permit> permits = Ask("a").granted;
  ASSERT_THAT(permits, SizeIs(4));
  for (int i = 0; i < 1000; ++i) {
    clock_.Advance(absl::Seconds(4));
    ASSERT_THAT(Ask("a", permits).lost, IsEmpty());
  }
  EXPECT_EQ(registry_.counters().lapsed, 0);
}

// Otherwise each iteration would wait for it again.
TEST_F(OverdueLanes, ALatePlayerPausesLongerEachTimeThenTriesOneLane) {
  std::vector<Permit> tried;
  FinishGood();
  tried = of_slow_;
  testing::internal::CaptureStderr();
  size_t most = 0;
  int tries = 0;
  for (int64_t iteration = 2; iteration < 200; ++iteration) {
    const absl::Time begun = clock_.Now();
    while (registry_.permits() > 0 || iteration == 2) {
      clock_.Advance(absl::Milliseconds(100));
      const TestRegistry::Grant grant = Ask("slow", tried);
      for (const Permit& lost : grant.lost) tried.erase(std::find(tried.begin(), tried.end(), lost));
      for (const Permit& permit : Ask("good").granted) ASSERT_EQ(Push("good", permit), Verdict::kAccepted);
      if (iteration == 2 && registry_.permits() == 0) break;
    }
    ASSERT_LT(clock_.Now() - begun, absl::Seconds(5)) << "no iteration waits longer";
    registry_.OpenIteration(iteration, kVersion + iteration);
    // An iteration takes a second.
    for (int i = 0; i < 10; ++i) {
      clock_.Advance(absl::Milliseconds(100));
      const TestRegistry::Grant of_slow = Ask("slow", tried);
      for (const Permit& lost : of_slow.lost) tried.erase(std::find(tried.begin(), tried.end(), lost));
      if (!of_slow.granted.empty()) ++tries;
      tried.insert(tried.end(), of_slow.granted.begin(), of_slow.granted.end());
      most = std::max(most, of_slow.granted.size());
      for (const Permit& permit : Ask("good").granted) ASSERT_EQ(Push("good", permit), Verdict::kAccepted);
    }
  }
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              AllOf(HasSubstr("actor slow has had fragment 0 of lane "), HasSubstr("actor good finished it")));
  EXPECT_EQ(most, 1) << "it tries one lane";
  EXPECT_LE(tries, 10) << "of 200 iterations";
  EXPECT_TRUE(IsLate("slow"));
  EXPECT_FALSE(IsLate("good"));
}

TEST_F(OverdueLanes, ALatePlayerGetsEvaluationTasksAfterOthers) {
  FinishGood();
  clock_.Advance(kTick);
  ASSERT_THAT(Ask("good").granted, SizeIs(2));
  ASSERT_EQ(Push("good", of_slow_[0]), Verdict::kAccepted);
  ASSERT_TRUE(IsLate("slow"));
  Evaluation evaluation;
  evaluation.number = 1;
  evaluation.episodes = 1;
  registry_.AddEvaluation(evaluation);
  const auto gets_task = [&](const std::string& actor) {
    WorkerRegistry::PermitRequest request = TestRegistry::RequestOf(actor, {}, 0);
    request.evaluates = true;
    const auto reply = registry_.GetPermits(request);
    return reply.ok() && reply->evaluation.has_value();
  };
  EXPECT_FALSE(gets_task("slow"));
  EXPECT_TRUE(gets_task("good"));
}

TEST_F(OverdueLanes, ALatePlayerThatFinishesAFragmentIsAsGoodAsOthers) {
  FinishGood();
  clock_.Advance(kTick);
  for (const Permit& permit : Ask("good").granted) ASSERT_EQ(Push("good", permit), Verdict::kAccepted);
  EXPECT_TRUE(IsLate("slow"));
  registry_.OpenIteration(2, kVersion + 1);
  Ask("slow");
  registry_.Drain("good");
  std::vector<Permit> granted;
  for (int i = 0; i < 20 && granted.empty(); ++i) {
    clock_.Advance(absl::Milliseconds(500));
    Ask("good");
    granted = Ask("slow").granted;
  }
  ASSERT_THAT(granted, SizeIs(1));
  EXPECT_EQ(Push("slow", granted[0]), Verdict::kAccepted);
  EXPECT_FALSE(IsLate("slow"));
  EXPECT_THAT(Ask("slow").granted, SizeIs(3));
}

// The only one that is on time vanishes: nobody waits for the end of the others' pauses.
TEST_F(OverdueLanes, LatePlayersGoOnIfThereIsNobodyElse) {
  FinishGood();
  clock_.Advance(kTick);
  for (const Permit& permit : Ask("good").granted) ASSERT_EQ(Push("good", permit), Verdict::kAccepted);
  ASSERT_TRUE(IsLate("slow"));
  Ask("slow");
  registry_.OpenIteration(2, kVersion + 1);
  registry_.Leave("good");
  EXPECT_THAT(Ask("slow").granted, SizeIs(1));
}

TEST_F(OverdueLanes, WhoHoldsWhatIsNamed) {
  FinishGood();
  clock_.Advance(absl::Seconds(1));
  Ask("good");
  clock_.Advance(absl::Seconds(2));
  EXPECT_THAT(registry_.WaitsFor(), HasSubstr(absl::StrCat("fragment 0 of lane ", of_slow_[0].lane,
                                                           " (actor slow for 6s, actor good for 2s)")));
  for (const Permit& permit : of_slow_) Push("slow", permit);
  EXPECT_EQ(registry_.WaitsFor(), "");
}

// In asynchronous play no actor is ever idle.
TEST(OverdueLanesOfAsynchronousPlay, TheyGoToAnActorWithRoomForMore) {
  FakeClock clock;
  LaneScheduler::Options options = {4};
  options.max_staleness = 2;
  options.rollout_fragments = 4;
  TestRegistry registry(options, std::vector<LaneRecord>(4), &clock);
  registry.PublishVersion(0);
  for (const char* name : {"stuck", "good"}) registry.Join(name, "");
  const std::vector<Permit> of_stuck = registry.GetPermits("stuck", {}, 100, absl::ZeroDuration())->granted;
  std::vector<Permit> of_good = registry.GetPermits("good", {}, 100, absl::ZeroDuration())->granted;
  ASSERT_THAT(of_stuck, SizeIs(2));
  clock.Advance(absl::Seconds(1));
  EXPECT_THAT(registry.GetPermits("stuck", of_stuck, 100, absl::ZeroDuration())->granted, IsEmpty());
  EXPECT_THAT(registry.Accept("good", of_good[0], {"after", {}}), IsOk());
  of_good.erase(of_good.begin());
  const std::vector<Permit> more = registry.GetPermits("good", of_good, 100, absl::ZeroDuration())->granted;
  ASSERT_THAT(more, SizeIs(1));
  of_good.push_back(more[0]);
  clock.Advance(absl::Seconds(4) + kTick);
  const auto grant = registry.GetPermits("good", of_good, 100, absl::ZeroDuration());
  ASSERT_THAT(grant, IsOk());
  EXPECT_THAT(grant->granted, ElementsAreArray(of_stuck));
}

}  // namespace lane_scheduler_overdue_test
}  // namespace craftfleet
