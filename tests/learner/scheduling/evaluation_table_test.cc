#include "learner/scheduling/evaluation_table.h"

#include <thread>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kLease = absl::Seconds(5);

Evaluation SampleEvaluation(int64_t number, int64_t first_episode, int episodes) {
  return {number, number * 1000, first_episode, episodes, false, std::make_shared<HostWeights>("weights")};
}

std::vector<Episode> Episodes(int count, int64_t length) {
  std::vector<Episode> episodes(count);
  for (Episode& episode : episodes) episode.length = length;
  return episodes;
}

class EvaluationTableTest : public testing::Test {
 protected:
  // Adds an evaluation, of which "good" plays one task, and "stuck" of another client has the other for too long.
  void LetATaskBeOverdue() {
    scheduler_.Add(SampleEvaluation(1, 1, 1));
    const auto task = scheduler_.Take("stuck", kLease, "client");
    const auto other = scheduler_.Take("good", kLease, "other");
    ASSERT_THAT(scheduler_.Finish("good", other->id, Episodes(1, 30)), IsOk());
    for (int second = 0; second <= 30; ++second) {
      scheduler_.Renew("stuck", task->id, kLease);
      clock_.Advance(absl::Seconds(1));
    }
  }

  FakeClock clock_;
  EvaluationTable scheduler_{&clock_};
};

TEST_F(EvaluationTableTest, AnEvaluationIsAnArgmaxTaskAndASampledTask) {
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
  EXPECT_EQ(**scheduler_.Weights(argmax->id)->Bytes(), "weights");
}

TEST_F(EvaluationTableTest, ResultsAreReturnedInOrderAndStayUntilPop) {
  scheduler_.Add(SampleEvaluation(1, 1, 2));
  scheduler_.Add(SampleEvaluation(2, 5, 2));
  std::vector<EvaluationTable::Task> tasks;
  while (const auto task = scheduler_.Take("a", kLease)) tasks.push_back(*task);
  ASSERT_EQ(tasks.size(), 4u);
  EXPECT_THAT(scheduler_.Finish("a", tasks[2].id, Episodes(2, 30)), IsOk());
  EXPECT_THAT(scheduler_.Finish("a", tasks[3].id, Episodes(2, 40)), IsOk());
  EXPECT_THAT(scheduler_.Finish("a", tasks[1].id, Episodes(2, 20)), IsOk());
  EXPECT_FALSE(scheduler_.Front().has_value()) << "the first is not finished";
  EXPECT_THAT(scheduler_.Finish("a", tasks[0].id, Episodes(2, 10)), IsOk());

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
TEST_F(EvaluationTableTest, AnOverdueTaskIsAlsoAssignedToAnotherActor) {
  scheduler_.Add(SampleEvaluation(1, 1, 2));
  const auto stuck = scheduler_.Take("stuck", kLease);
  const auto other = scheduler_.Take("good", kLease);
  const auto wait = [&](int seconds) {
    for (int i = 0; i < seconds; ++i) {
      clock_.Advance(absl::Seconds(1));
      scheduler_.Renew("stuck", stuck->id, kLease);
    }
  };
  for (int second = 0; second < 60; ++second) {
    wait(1);
    scheduler_.Renew("good", other->id, kLease);
  }
  EXPECT_FALSE(scheduler_.Take("third", kLease).has_value()) << "there are no results yet";
  EXPECT_THAT(scheduler_.Finish("good", other->id, Episodes(2, 30)), IsOk());
  wait(180);
  EXPECT_FALSE(scheduler_.Take("good", kLease).has_value()) << "four times a minute";
  wait(3);
  EXPECT_FALSE(scheduler_.Take("stuck", kLease).has_value()) << "it already has the task";
  const auto again = scheduler_.Take("good", kLease);
  ASSERT_TRUE(again.has_value());
  EXPECT_EQ(again->id, stuck->id);
  EXPECT_FALSE(scheduler_.Take("third", kLease).has_value()) << "the last one has only just got it";
  EXPECT_THAT(scheduler_.BeingPlayed(),
              testing::ElementsAre("evaluation task 2 (actor stuck for 4m3s, actor good for 0)"));
  EXPECT_THAT(scheduler_.Finish("stuck", stuck->id, Episodes(2, 40)), IsOk()) << "the first result counts";
  EXPECT_TRUE(scheduler_.Front().has_value());
  EXPECT_THAT(scheduler_.BeingPlayed(), testing::IsEmpty());
}

// Before, the limit doubled each time: 2, 4, 8 ... minutes.
TEST_F(EvaluationTableTest, ActorsThatOnlyReportHoldATaskUpForTheSameTimeEach) {
  scheduler_.Add(SampleEvaluation(1, 1, 1));
  const auto task = scheduler_.Take("stuck 0", kLease);
  const auto other = scheduler_.Take("good", kLease);
  clock_.Advance(absl::Seconds(4));
  ASSERT_THAT(scheduler_.Finish("good", other->id, Episodes(1, 30)), IsOk());
  for (int i = 1; i <= 6; ++i) {
    for (int second = 0; second < 33; ++second) {
      for (int k = 0; k < i; ++k) scheduler_.Renew(absl::StrCat("stuck ", k), task->id, kLease);
      clock_.Advance(absl::Seconds(1));
    }
    EXPECT_TRUE(scheduler_.Take(absl::StrCat("stuck ", i), kLease).has_value()) << i;
  }
}

TEST_F(EvaluationTableTest, ActorsOfOtherClientsGetAnOverdueTaskFirst) {
  LetATaskBeOverdue();
  EXPECT_FALSE(scheduler_.Take("second name", kLease, "client").has_value());
  EXPECT_TRUE(scheduler_.Take("good", kLease, "other").has_value());
}

TEST_F(EvaluationTableTest, AnOverdueTaskThatItsNewPlayerReturnsIsFreeForOthersAtOnce) {
  LetATaskBeOverdue();
  ASSERT_TRUE(scheduler_.Take("good", kLease, "other").has_value());
  scheduler_.Renew("good", 0, kLease);
  EXPECT_TRUE(scheduler_.Take("third", kLease, "third").has_value());
}

// Before, tasks went from one hanging actor to the next while another had time for them.
TEST_F(EvaluationTableTest, ActorsThatAreLateWithFragmentsComeLast) {
  scheduler_.Add(SampleEvaluation(1, 1, 1));
  const auto take_late = [&] { return scheduler_.Take("late", kLease, "client", /*is_late=*/true); };
  EXPECT_FALSE(take_late().has_value());
  const auto task = scheduler_.Take("stuck", kLease, "other");
  ASSERT_TRUE(task.has_value());
  clock_.Advance(EvaluationTable::kPatienceWithLate);
  scheduler_.Renew("stuck", task->id, kLease);
  const auto sampled = take_late();
  ASSERT_TRUE(sampled.has_value()) << "nobody else has asked for it";
  EXPECT_NE(sampled->id, task->id);
  ASSERT_THAT(scheduler_.Finish("late", sampled->id, Episodes(1, 30)), IsOk());
  for (int second = 0; second < 25; ++second) {
    scheduler_.Renew("stuck", task->id, kLease);
    clock_.Advance(absl::Seconds(1));
  }
  EXPECT_FALSE(take_late().has_value()) << "it is overdue, but only just";
  EXPECT_TRUE(scheduler_.Take("good", kLease, "third").has_value());
}

TEST_F(EvaluationTableTest, ATaskLapsesUnlessItsActorReportsIt) {
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

TEST_F(EvaluationTableTest, ATaskThatIsNoLongerReportedIsFreeAtOnce) {
  scheduler_.Add(SampleEvaluation(1, 1, 1));
  const auto task = scheduler_.Take("a", kLease);
  ASSERT_TRUE(scheduler_.Take("b", kLease).has_value());
  scheduler_.Renew("a", 0, kLease);
  EXPECT_EQ(scheduler_.Take("c", kLease)->id, task->id);
}

TEST_F(EvaluationTableTest, TheFirstResultCountsAndAnotherOneIsAnError) {
  scheduler_.Add(SampleEvaluation(1, 1, 1));
  const int64_t argmax = scheduler_.Take("a", kLease)->id;
  const int64_t sampled = scheduler_.Take("a", kLease)->id;
  clock_.Advance(kLease + absl::Seconds(1));
  ASSERT_EQ(scheduler_.Take("b", kLease)->id, argmax) << "a has not reported it";
  EXPECT_THAT(scheduler_.Finish("a", argmax, Episodes(1, 10)), IsOk()) << "but may still send it";
  EXPECT_EQ(scheduler_.Weights(argmax), nullptr);
  EXPECT_THAT(scheduler_.Finish("b", argmax, Episodes(1, 10)), IsOk()) << "the same result";
  EXPECT_THAT(
      scheduler_.Finish("b", argmax, Episodes(1, 99)),
      StatusIs(absl::StatusCode::kInvalidArgument, testing::HasSubstr("actor b sent another result than actor a")));
  EXPECT_THAT(scheduler_.Finish("a", sampled, Episodes(1, 20)), IsOk());
  EXPECT_EQ(scheduler_.Front()->argmax[0].length, 10);
  scheduler_.Pop();
  EXPECT_THAT(scheduler_.Finish("a", argmax, Episodes(1, 10)), IsOk()) << "a late result is ignored";
}

TEST_F(EvaluationTableTest, OnlyAnActorThatHasTheTaskMaySendItsResult) {
  scheduler_.Add(SampleEvaluation(1, 1, 1));
  const int64_t argmax = scheduler_.Take("a", kLease)->id;
  EXPECT_THAT(scheduler_.Finish("stranger", argmax, Episodes(1, 10)),
              StatusIs(absl::StatusCode::kFailedPrecondition, testing::HasSubstr("actor stranger does not have it")));
  scheduler_.Renew("a", 0, kLease);
  EXPECT_THAT(scheduler_.Finish("a", argmax, Episodes(1, 10)),
              StatusIs(absl::StatusCode::kFailedPrecondition, testing::_));
}

TEST_F(EvaluationTableTest, AWrongNumberOfEpisodesIsRefused) {
  scheduler_.Add(SampleEvaluation(1, 1, 5));
  const int64_t id = scheduler_.Take("a", kLease)->id;
  EXPECT_THAT(scheduler_.Finish("a", id, Episodes(4, 10)),
              StatusIs(absl::StatusCode::kInvalidArgument, testing::HasSubstr("4 episodes, want 5")));
  EXPECT_NE(scheduler_.Weights(id), nullptr);
}

TEST(WorkerRegistryEvaluations, FrontWaitsForTheResult) {
  FakeClock clock;
  TestRegistry registry({1}, std::vector<LaneRecord>(1), &clock);
  registry.Join("a", "");
  registry.Join("b", "");
  registry.AddEvaluation(SampleEvaluation(1, 1, 1));
  EXPECT_EQ(registry.pending_evaluations(), 1);
  for (int i = 0; i < 2; ++i) {
    WorkerRegistry::PermitRequest request = TestRegistry::RequestOf(i == 0 ? "a" : "b", {}, 0);
    request.evaluates = true;
    ASSERT_TRUE(registry.GetPermits(request)->evaluation.has_value());
  }
  std::thread actor([&] {
    EXPECT_THAT(registry.FinishEvaluation("a", 2, Episodes(1, 10)), IsOk());
    EXPECT_THAT(registry.FinishEvaluation("b", 3, Episodes(1, 10)), IsOk());
  });
  EXPECT_TRUE(registry.FrontEvaluation(absl::Seconds(60)).has_value());
  actor.join();
}

}  // namespace
}  // namespace craftfleet
