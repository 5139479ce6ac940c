#include "learner/evaluation_scheduler.h"

#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/test_registry.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kLease = absl::Seconds(5);

Evaluation SampleEvaluation(int64_t number, int64_t first_episode, int episodes) {
  return {number, number * 1000, first_episode, episodes, false, std::make_shared<std::string>("weights")};
}

std::vector<Episode> Episodes(int count, int64_t length) {
  std::vector<Episode> episodes(count);
  for (Episode& episode : episodes) episode.length = length;
  return episodes;
}

class EvaluationSchedulerTest : public testing::Test {
 protected:
  FakeClock clock_;
  EvaluationScheduler scheduler_{&clock_};
};

TEST_F(EvaluationSchedulerTest, AnEvaluationIsAnArgmaxTaskAndASampledTask) {
  EXPECT_FALSE(scheduler_.Take("a", kLease).has_value());
  scheduler_.Add(SampleEvaluation(3, 21, 5));
  const auto argmax = scheduler_.Take("a", kLease);
  const auto sampled = scheduler_.Take("b", kLease);
  ASSERT_TRUE(argmax.has_value() && sampled.has_value());
  EXPECT_TRUE(argmax->greedy);
  EXPECT_EQ(argmax->first_episode, 21);
  EXPECT_EQ(argmax->episodes, 5);
  EXPECT_FALSE(sampled->greedy);
  EXPECT_EQ(sampled->first_episode, 26);
  EXPECT_EQ(sampled->episodes, 5);
  EXPECT_NE(argmax->id, sampled->id);
  EXPECT_FALSE(scheduler_.Take("c", kLease).has_value());
  EXPECT_EQ(*scheduler_.Weights(argmax->id), "weights");
}

TEST_F(EvaluationSchedulerTest, ResultsAreReturnedInOrderAndStayUntilPop) {
  scheduler_.Add(SampleEvaluation(1, 1, 2));
  scheduler_.Add(SampleEvaluation(2, 5, 2));
  std::vector<EvaluationScheduler::Task> tasks;
  while (const auto task = scheduler_.Take("a", kLease)) tasks.push_back(*task);
  ASSERT_EQ(tasks.size(), 4u);
  EXPECT_THAT(scheduler_.Finish(tasks[2].id, Episodes(2, 30)), IsOk());
  EXPECT_THAT(scheduler_.Finish(tasks[3].id, Episodes(2, 40)), IsOk());
  EXPECT_THAT(scheduler_.Finish(tasks[1].id, Episodes(2, 20)), IsOk());
  EXPECT_FALSE(scheduler_.Front().has_value()) << "the first is not finished";
  EXPECT_THAT(scheduler_.Finish(tasks[0].id, Episodes(2, 10)), IsOk());

  for (int look = 0; look < 2; ++look) {
    const auto first = scheduler_.Front();
    ASSERT_TRUE(first.has_value());
    EXPECT_EQ(first->evaluation.number, 1);
    EXPECT_EQ(first->argmax[0].length, 10);
    EXPECT_EQ(first->sampled[1].length, 20);
    EXPECT_EQ(scheduler_.Pending().size(), 2u);
  }
  scheduler_.Pop();
  EXPECT_EQ(scheduler_.Front()->evaluation.number, 2);
  EXPECT_EQ(scheduler_.Pending().size(), 1u);
}

// An actor that reports a task but never finishes it must not hold up the end of a run.
TEST_F(EvaluationSchedulerTest, ASlowTaskIsAlsoAssignedToAnotherActor) {
  scheduler_.Add(SampleEvaluation(1, 1, 2));
  const auto stuck = scheduler_.Take("stuck", kLease);
  const auto other = scheduler_.Take("good", kLease);
  clock_.Advance(absl::Seconds(20));
  EXPECT_THAT(scheduler_.Finish(other->id, Episodes(2, 30)), IsOk());
  const auto wait = [&](int seconds) {
    for (int i = 0; i < seconds; ++i) {
      clock_.Advance(absl::Seconds(1));
      scheduler_.Renew("stuck", stuck->id, kLease);
    }
  };
  wait(100);
  EXPECT_FALSE(scheduler_.Take("good", kLease).has_value()) << "two minutes";
  wait(1);
  EXPECT_FALSE(scheduler_.Take("stuck", kLease).has_value()) << "it already has the task";
  const auto again = scheduler_.Take("good", kLease);
  ASSERT_TRUE(again.has_value());
  EXPECT_EQ(again->id, stuck->id);
  EXPECT_FALSE(scheduler_.Take("third", kLease).has_value());
  EXPECT_THAT(scheduler_.Finish(stuck->id, Episodes(2, 40)), IsOk()) << "the first result counts";
  EXPECT_TRUE(scheduler_.Front().has_value());
}

// An actor that sends each result just before its task would move could otherwise quadruple the limit again and again.
TEST_F(EvaluationSchedulerTest, AnActorThatDawdlesDoesNotStretchTheLimit) {
  for (int number = 1; number <= 5; ++number) {
    scheduler_.Add(SampleEvaluation(number, 1, 1));
    const auto slow = scheduler_.Take("dawdler", kLease);
    const auto quick = scheduler_.Take("good", kLease);
    clock_.Advance(absl::Seconds(10));
    ASSERT_THAT(scheduler_.Finish(quick->id, Episodes(1, 30)), IsOk());
    for (int i = 0; i < 110; ++i) {
      clock_.Advance(absl::Seconds(1));
      scheduler_.Renew("dawdler", slow->id, kLease);
    }
    if (number == 5) {
      EXPECT_FALSE(scheduler_.Take("good", kLease).has_value()) << "two minutes";
      clock_.Advance(absl::Seconds(1));
      EXPECT_TRUE(scheduler_.Take("good", kLease).has_value());
    }
    ASSERT_THAT(scheduler_.Finish(slow->id, Episodes(1, 30)), IsOk());
    scheduler_.Pop();
  }
}

TEST_F(EvaluationSchedulerTest, TheLimitFollowsTasksThatTakeLonger) {
  for (int number = 1; number <= 2; ++number) {
    scheduler_.Add(SampleEvaluation(number, 1, 1));
    const auto argmax = scheduler_.Take("a", kLease);
    const auto sampled = scheduler_.Take("b", kLease);
    const int minutes = number == 1 ? 1 : 4;
    for (int i = 0; i < 60 * minutes; ++i) {
      clock_.Advance(absl::Seconds(1));
      scheduler_.Renew("a", argmax->id, kLease);
      scheduler_.Renew("b", sampled->id, kLease);
      EXPECT_FALSE(scheduler_.Take("c", kLease).has_value()) << i;
    }
    for (const auto& task : {argmax, sampled}) ASSERT_THAT(scheduler_.Finish(task->id, Episodes(1, 30)), IsOk());
    scheduler_.Pop();
  }
}

TEST_F(EvaluationSchedulerTest, ATaskLapsesUnlessItsActorReportsIt) {
  scheduler_.Add(SampleEvaluation(1, 1, 1));
  const auto task = scheduler_.Take("a", kLease);
  ASSERT_TRUE(scheduler_.Take("b", kLease).has_value());
  clock_.Advance(kLease - absl::Seconds(1));
  scheduler_.Renew("a", task->id, kLease);
  clock_.Advance(absl::Seconds(2));
  EXPECT_FALSE(scheduler_.Take("c", kLease)->greedy) << "b's task, which b did not report";
  EXPECT_FALSE(scheduler_.Take("c", kLease).has_value()) << "a's task was renewed";
  clock_.Advance(kLease);
  EXPECT_EQ(scheduler_.Take("c", kLease)->id, task->id);
}

TEST_F(EvaluationSchedulerTest, ATaskThatIsNoLongerReportedIsFreeAtOnce) {
  scheduler_.Add(SampleEvaluation(1, 1, 1));
  const auto task = scheduler_.Take("a", kLease);
  ASSERT_TRUE(scheduler_.Take("b", kLease).has_value());
  scheduler_.Renew("a", 0, kLease);
  EXPECT_EQ(scheduler_.Take("c", kLease)->id, task->id);
}

TEST_F(EvaluationSchedulerTest, TheFirstResultCountsAndLaterOnesAreIgnored) {
  scheduler_.Add(SampleEvaluation(1, 1, 1));
  const int64_t argmax = scheduler_.Take("a", kLease)->id;
  const int64_t sampled = scheduler_.Take("a", kLease)->id;
  EXPECT_THAT(scheduler_.Finish(argmax, Episodes(1, 10)), IsOk());
  EXPECT_THAT(scheduler_.Finish(argmax, Episodes(1, 99)), IsOk());
  EXPECT_EQ(scheduler_.Weights(argmax), nullptr);
  EXPECT_THAT(scheduler_.Finish(sampled, Episodes(1, 20)), IsOk());
  EXPECT_EQ(scheduler_.Front()->argmax[0].length, 10);
  scheduler_.Pop();
  EXPECT_THAT(scheduler_.Finish(argmax, Episodes(1, 10)), IsOk()) << "a late result is ignored";
}

TEST_F(EvaluationSchedulerTest, AWrongNumberOfEpisodesIsRefused) {
  scheduler_.Add(SampleEvaluation(1, 1, 5));
  const int64_t id = scheduler_.Take("a", kLease)->id;
  EXPECT_THAT(scheduler_.Finish(id, Episodes(4, 10)),
              StatusIs(absl::StatusCode::kInvalidArgument, testing::HasSubstr("4 episodes, want 5")));
  EXPECT_NE(scheduler_.Weights(id), nullptr);
}

TEST(WorkerRegistryEvaluations, FrontWaitsForTheResult) {
  FakeClock clock;
  TestRegistry registry({1}, std::vector<LaneRecord>(1), &clock);
  registry.Join("a", "");
  registry.AddEvaluation(SampleEvaluation(1, 1, 1));
  EXPECT_EQ(registry.pending_evaluations(), 1);
  std::thread actor([&] {
    for (const int64_t task : {2, 3}) EXPECT_TRUE(registry.FinishEvaluation("a", task, Episodes(1, 10)).ok());
  });
  EXPECT_TRUE(registry.FrontEvaluation(absl::Seconds(60)).has_value());
  actor.join();
}

}  // namespace
}  // namespace craftfleet
