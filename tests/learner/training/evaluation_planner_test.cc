#include "learner/training/evaluation_planner.h"

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/seeds.h"
#include "tests/fakes/wait_until.h"
#include "tests/learner/run/read_events.h"
#include "tests/learner/run/run_samples.h"
#include "tests/learner/scheduling/test_registry.h"
#include "tests/learner/training/records/open_run.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

using Task = EvaluationTable::Task;

constexpr int64_t kEvery = 1000;       // steps
constexpr int kEpisodes = 2;           // of each kind, during training
constexpr int kFinalEpisodes = 3;      // of each kind, after it
constexpr int64_t kRunSteps = 10'000;  // of the run

std::shared_ptr<const PolicyWeights> Weights(const std::string& bytes) {
  return std::make_shared<const HostWeights>(bytes);
}

bool NeverStop() { return false; }

// One start of a learner; the test acts as the actors.
struct Start {
  Start(const v1::EvalConfig& config, const Checkpoint& checkpoint, RunFolder* run, Clock* clock,
        int64_t steps = kRunSteps)
      : registry({1}, std::vector<LaneRecord>(1), clock), planner(config, steps, checkpoint, &registry, run) {}

  // Finishes an iteration of `length` steps.
  void Train(int64_t length, const std::string& weights = "w") {
    steps += length;
    planner.OnIteration(steps - length, steps, Weights(weights), NeverStop);
  }
  // The task that a new actor gets.
  std::optional<Task> Take(const std::string& actor) {
    registry.Join(actor, "");
    TestRegistry::PermitRequest request = TestRegistry::RequestOf(actor, {}, 0);
    request.evaluates = true;
    const auto reply = registry.GetPermits(request);
    if (!reply.ok() || !reply->evaluation.has_value()) return std::nullopt;
    holders_[reply->evaluation->id] = actor;
    return reply->evaluation;
  }
  std::vector<Task> TakeAll() {
    std::vector<Task> tasks;
    while (const std::optional<Task> task = Take(absl::StrCat("actor ", ++actors_))) tasks.push_back(*task);
    return tasks;
  }
  // Finishes a task with episodes of one length, by which the test identifies them.
  void Finish(const Task& task, int64_t length) {
    std::vector<Episode> episodes(task.episodes);
    for (Episode& episode : episodes) episode.length = length;
    EXPECT_THAT(registry.FinishEvaluation(holders_.at(task.id), task.id, episodes), IsOk());
  }
  // Plays all tasks; the episodes of a task are as long as the number of its first episode.
  void PlayAll() {
    for (const Task& task : TakeAll()) Finish(task, task.first_episode);
  }
  // Ends training, and plays the final evaluation in another thread.
  void End(int64_t env_steps, const std::string& weights = "w") {
    std::atomic<bool> over{false};
    std::thread actor([&] {
      while (!over) {
        PlayAll();
        absl::SleepFor(absl::Milliseconds(1));
      }
    });
    planner.OnEnd(env_steps, Weights(weights), NeverStop);
    over = true;
    actor.join();
  }
  Checkpoint Save(int64_t env_steps = 0) const {
    Checkpoint checkpoint;
    checkpoint.state.set_env_steps(env_steps);
    EXPECT_THAT(planner.FillCheckpoint(&checkpoint), IsOk());
    return checkpoint;
  }
  std::vector<Evaluation> Pending() { return registry.evaluations()->Pending(); }

  TestRegistry registry;
  EvaluationPlanner planner;
  int64_t steps = 0;

 private:
  int actors_ = 0;
  std::map<int64_t, std::string> holders_;  // of tasks
};

class EvaluationPlannerTest : public OpenRun {
 protected:
  EvaluationPlannerTest() {
    config_.set_every_steps(kEvery);
    config_.set_episodes(kEpisodes);
    config_.set_final_episodes(kFinalEpisodes);
  }
  std::unique_ptr<Start> Begin(const Checkpoint& checkpoint = {}, int64_t steps = kRunSteps) {
    return std::make_unique<Start>(config_, checkpoint, run_.get(), &clock_, steps);
  }
  // The lengths of the episodes in a log.
  std::vector<int64_t> Lengths(const std::string& log) {
    EXPECT_THAT(run_->FlushLogs(), IsOk());
    std::vector<int64_t> lengths;
    for (const Episode& episode : ReadStats(JoinPath(logdir_, log))) lengths.push_back(episode.length);
    return lengths;
  }

  v1::EvalConfig config_;
};

TEST_F(EvaluationPlannerTest, EvaluatesWheneverTrainingPassesAMultipleOfEverySteps) {
  const auto start = Begin();
  start->Train(900);
  EXPECT_THAT(start->Pending(), IsEmpty());
  start->Train(100, "first");
  EXPECT_THAT(start->Pending(), SizeIs(1)) << "the multiple is reached";
  start->Train(900);
  EXPECT_THAT(start->Pending(), SizeIs(1));
  start->Train(2300, "second");
  ASSERT_THAT(start->Pending(), SizeIs(2)) << "only one, even if several multiples are passed at once";
  const std::vector<Evaluation> pending = start->Pending();
  EXPECT_EQ(pending[0].env_steps, 1000);
  EXPECT_EQ(**pending[0].weights->Bytes(), "first");
  EXPECT_EQ(pending[1].env_steps, 4200);
  EXPECT_EQ(**pending[1].weights->Bytes(), "second");
  EXPECT_EQ(pending[0].number, 1);
  EXPECT_EQ(pending[1].number, 2);
  EXPECT_FALSE(pending[0].final || pending[1].final);
}

// Actors would end at a task of no episodes.
TEST_F(EvaluationPlannerTest, WithoutEveryStepsOrEpisodesNothingIsEvaluatedInTraining) {
  for (const bool no_steps : {true, false}) {
    config_.set_every_steps(no_steps ? 0 : kEvery);
    config_.set_episodes(no_steps ? kEpisodes : 0);
    const auto start = Begin();
    start->Train(5000);
    EXPECT_THAT(start->Pending(), IsEmpty());
  }
}

TEST_F(EvaluationPlannerTest, EpisodesContinueFromEvaluationToEvaluation) {
  const auto start = Begin();
  for (int64_t number = 1; number <= 3; ++number) {
    start->Train(kEvery);
    const std::vector<Task> tasks = start->TakeAll();
    ASSERT_THAT(tasks, SizeIs(2));
    EXPECT_EQ(tasks[0].episodes, kEpisodes);
    EXPECT_EQ(tasks[0].first_episode, 1 + (number - 1) * 2 * kEpisodes);
    EXPECT_TRUE(tasks[0].greedy);
    EXPECT_EQ(tasks[1].episodes, kEpisodes);
    EXPECT_EQ(tasks[1].first_episode, tasks[0].first_episode + kEpisodes);
    EXPECT_FALSE(tasks[1].greedy);
    for (const Task& task : tasks) start->Finish(task, 1);
  }
}

TEST_F(EvaluationPlannerTest, AfterTheLastEpisodeTheyBeginAgain) {
  Checkpoint checkpoint;
  checkpoint.state.set_next_eval_episode(kLastEvaluationEpisode - 2 * 2 * kEpisodes);
  const auto start = Begin(checkpoint);
  for (int i = 0; i < 3; ++i) {
    start->Train(kEvery);
    start->PlayAll();
  }
  start->Train(1);
  EXPECT_THAT(Lengths("eval_argmax.jsonl"), ElementsAre(kLastEvaluationEpisode - 8, kLastEvaluationEpisode - 8,
                                                        kLastEvaluationEpisode - 4, kLastEvaluationEpisode - 4, 1, 1));
}

TEST_F(EvaluationPlannerTest, AFinalEvaluationDoesNotAdvanceTheEpisodeNumbers) {
  const auto start = Begin();
  start->Train(kEvery);
  start->PlayAll();
  start->End(kEvery);
  EXPECT_THAT(Lengths("eval_argmax.jsonl"), ElementsAre(1, 1));
  EXPECT_THAT(Lengths("eval_sampled.jsonl"), ElementsAre(3, 3));
  EXPECT_THAT(Lengths("final_argmax.jsonl"), ElementsAre(5, 5, 5));
  EXPECT_THAT(Lengths("final_sampled.jsonl"), ElementsAre(8, 8, 8));
  start->Train(kEvery);
  EXPECT_EQ(start->Pending()[0].first_episode, 5) << "as if the run had not ended before";
  EXPECT_EQ(start->Pending()[0].number, 3);
}

TEST_F(EvaluationPlannerTest, TheFinalEvaluationUsesTheFinalWeights) {
  const auto start = Begin();
  start->planner.OnEnd(kRunSteps, Weights("last"), [] { return true; });
  ASSERT_THAT(start->Pending(), SizeIs(1));
  EXPECT_TRUE(start->Pending()[0].final);
  EXPECT_EQ(start->Pending()[0].env_steps, kRunSteps);
  EXPECT_EQ(start->Pending()[0].episodes, kFinalEpisodes);
  EXPECT_EQ(**start->Pending()[0].weights->Bytes(), "last");
}

TEST_F(EvaluationPlannerTest, WithoutFinalEpisodesTheEndDoesNotWait) {
  config_.set_final_episodes(0);
  const auto start = Begin();
  start->planner.OnEnd(kRunSteps, Weights("w"), [] { return true; });
  EXPECT_EQ(start->planner.pending(), 0u);
}

TEST_F(EvaluationPlannerTest, TheEndWaitsUntilTheFinalEvaluationIsLogged) {
  const auto start = Begin();
  std::atomic<bool> over{false};
  std::thread training([&] {
    start->planner.OnEnd(kRunSteps, Weights("w"), NeverStop);
    over = true;
  });
  EXPECT_FALSE(WaitUntil([&] { return over.load(); }, absl::Milliseconds(300)));
  start->PlayAll();
  training.join();
  EXPECT_THAT(Lengths("final_sampled.jsonl"), SizeIs(kFinalEpisodes));
}

TEST_F(EvaluationPlannerTest, TheEndAlsoWaitsForEarlierEvaluations) {
  config_.set_final_episodes(0);
  const auto start = Begin();
  start->Train(kEvery);
  EXPECT_EQ(start->planner.pending(), 1u);
  testing::internal::CaptureStderr();
  start->End(kEvery);
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("waiting for the remaining evaluations (1)"));
  EXPECT_EQ(start->planner.pending(), 0u);
  EXPECT_THAT(Lengths("eval_argmax.jsonl"), SizeIs(kEpisodes));
}

TEST_F(EvaluationPlannerTest, AResumedRunIsNotEvaluatedTwiceAtItsEnd) {
  const auto first = Begin();
  first->End(kRunSteps);
  const auto again = Begin(first->Save(kRunSteps));
  again->planner.OnEnd(kRunSteps, Weights("w"), [] { return true; });
  EXPECT_EQ(again->planner.pending(), 0u);
  EXPECT_THAT(Lengths("final_argmax.jsonl"), SizeIs(kFinalEpisodes));
  const auto longer = Begin(first->Save(kRunSteps), 2 * kRunSteps);
  longer->planner.OnEnd(2 * kRunSteps, Weights("w"), [] { return true; });
  EXPECT_THAT(longer->Pending(), SizeIs(1)) << "an extended run is";
}

TEST_F(EvaluationPlannerTest, LogsInTheOrderOfTheEvaluations) {
  const auto start = Begin();
  start->Train(kEvery);
  start->Train(kEvery);
  const std::vector<Task> tasks = start->TakeAll();
  ASSERT_THAT(tasks, SizeIs(4));
  start->Finish(tasks[3], 40);
  start->Finish(tasks[2], 30);
  start->Finish(tasks[1], 20);
  start->Train(1);
  EXPECT_THAT(Lengths("eval_argmax.jsonl"), IsEmpty()) << "the first is not finished";
  start->Finish(tasks[0], 10);
  start->Train(1);
  EXPECT_THAT(Lengths("eval_argmax.jsonl"), ElementsAre(10, 10, 30, 30));
  EXPECT_THAT(Lengths("eval_sampled.jsonl"), ElementsAre(20, 20, 40, 40));
  EXPECT_EQ(start->planner.pending(), 0u);
  // Each point is at the steps of its weights.
  const std::vector<v1::Event> events = ReadEvents(logdir_ + "/events.out.tfevents.craftfleet");
  ASSERT_THAT(events, SizeIs(3));
  EXPECT_EQ(events[1].step(), 1000);
  EXPECT_EQ(events[2].step(), 2000);
  EXPECT_EQ(events[1].summary().value(0).tag(), "eval/argmax_score");
  EXPECT_EQ(events[1].summary().value(1).tag(), "eval/argmax_reward");
  EXPECT_EQ(events[1].summary().value(2).tag(), "eval/sampled_score");
  EXPECT_EQ(events[1].summary().value(3).tag(), "eval/sampled_reward");
}

TEST_F(EvaluationPlannerTest, TheFinalEvaluationHasItsOwnCurves) {
  const auto start = Begin();
  start->End(kRunSteps);
  const std::vector<v1::Event> events = ReadEvents(logdir_ + "/events.out.tfevents.craftfleet");
  ASSERT_THAT(events, SizeIs(2));
  EXPECT_EQ(events[1].step(), kRunSteps);
  EXPECT_EQ(events[1].summary().value(0).tag(), "final/argmax_score");
  EXPECT_EQ(events[1].summary().value(3).tag(), "final/sampled_reward");
}

TEST_F(EvaluationPlannerTest, TrainingWaitsForTheOldestOfTwoBeforeAThird) {
  const auto start = Begin();
  start->Train(kEvery);
  start->Train(kEvery);
  start->Train(kEvery - 1);  // none is due: nothing to wait for
  const std::vector<Task> tasks = start->TakeAll();
  std::atomic<bool> trained{false};
  std::thread training([&] {
    start->Train(1);
    trained = true;
  });
  EXPECT_FALSE(WaitUntil([&] { return trained.load(); }, absl::Milliseconds(300)));
  start->Finish(tasks[0], 10);
  start->Finish(tasks[1], 20);
  training.join();
  EXPECT_EQ(start->planner.pending(), 2u);
  EXPECT_EQ(start->Pending()[1].number, 3);
}

// Each start that is stopped in its wait would otherwise leave one more, until the checkpoint holds too many to be
// read.
TEST_F(EvaluationPlannerTest, AStartWithTooManyPendingWaitsBeforeItTrains) {
  const auto stopped = Begin();
  stopped->Train(kEvery);
  stopped->Train(kEvery);
  stopped->planner.OnIteration(2 * kEvery, 3 * kEvery, Weights("third"), [] { return true; });
  const auto start = Begin(stopped->Save(3 * kEvery));
  ASSERT_EQ(start->planner.pending(), 3u);
  std::atomic<bool> begun{false};
  std::thread training([&] {
    start->planner.OnStart(NeverStop);
    begun = true;
  });
  EXPECT_FALSE(WaitUntil([&] { return begun.load(); }, absl::Milliseconds(300)));
  const std::vector<Task> tasks = start->TakeAll();
  start->Finish(tasks[0], 10);
  start->Finish(tasks[1], 20);
  training.join();
  EXPECT_EQ(start->planner.pending(), 2u);
  start->planner.OnStart([] { return true; });  // does not wait
}

// A checkpoint that is requested then must not lose the evaluation.
TEST_F(EvaluationPlannerTest, ACheckpointDuringTheWaitHasTheEvaluationThatIsDue) {
  const auto start = Begin();
  start->Train(kEvery);
  start->Train(kEvery);
  Checkpoint checkpoint;
  const auto save = [&] {
    checkpoint = start->Save();
    return true;
  };
  start->planner.OnIteration(2 * kEvery, 3 * kEvery, Weights("third"), save);
  ASSERT_EQ(checkpoint.state.pending_size(), 3);
  EXPECT_EQ(checkpoint.state.evaluations(), 3);
  EXPECT_EQ(*checkpoint.evaluation_weights[2], "third");
}

TEST_F(EvaluationPlannerTest, AStopEndsTheWaitAndTheNextStartContinues) {
  const auto start = Begin();
  start->Train(kEvery, "in training");
  start->planner.OnEnd(kEvery, Weights("last"), [] { return true; });
  EXPECT_EQ(start->planner.pending(), 2u);
  EXPECT_THAT(Lengths("final_argmax.jsonl"), IsEmpty());

  const Checkpoint checkpoint = start->Save(kEvery);
  ASSERT_THAT(checkpoint.evaluation_weights, SizeIs(2));
  const auto resumed = Begin(checkpoint, kEvery);
  ASSERT_THAT(resumed->Pending(), SizeIs(2));
  const std::vector<Evaluation> before = start->Pending(), after = resumed->Pending();
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(after[i].number, before[i].number);
    EXPECT_EQ(after[i].env_steps, before[i].env_steps);
    EXPECT_EQ(after[i].first_episode, before[i].first_episode);
    EXPECT_EQ(after[i].episodes, before[i].episodes);
    EXPECT_EQ(after[i].final, before[i].final);
    EXPECT_EQ(**after[i].weights->Bytes(), **before[i].weights->Bytes());
  }
  resumed->End(kEvery, "last");
  EXPECT_THAT(Lengths("eval_argmax.jsonl"), ElementsAre(1, 1));
  EXPECT_THAT(Lengths("final_argmax.jsonl"), ElementsAre(5, 5, 5)) << "once";
}

TEST_F(EvaluationPlannerTest, ACheckpointStoresWhereToContinue) {
  const auto start = Begin();
  for (int i = 0; i < 3; ++i) {
    start->Train(kEvery);
    start->PlayAll();
  }
  start->Train(1);
  const Checkpoint checkpoint = start->Save();
  EXPECT_EQ(checkpoint.state.evaluations(), 3);
  EXPECT_EQ(checkpoint.state.next_eval_episode(), 1 + 3 * 2 * kEpisodes);
  EXPECT_EQ(checkpoint.state.final_evaluation_steps(), 0);
  EXPECT_EQ(checkpoint.state.pending_size(), 0);
  const auto resumed = Begin(checkpoint);
  resumed->Train(kEvery);
  EXPECT_EQ(resumed->Pending()[0].number, 4);
  EXPECT_EQ(resumed->Pending()[0].first_episode, 1 + 3 * 2 * kEpisodes);
}

// Its weights are no longer the final ones, so its result must not get into the final logs.
TEST_F(EvaluationPlannerTest, AnExtendedRunDropsAPendingFinalEvaluation) {
  const auto start = Begin();
  start->Train(kEvery, "in training");
  start->planner.OnEnd(kEvery, Weights("last"), [] { return true; });
  const Checkpoint checkpoint = start->Save(kEvery);
  EXPECT_EQ(checkpoint.state.final_evaluation_steps(), kEvery);

  const auto longer = Begin(checkpoint, kEvery + 1);
  ASSERT_THAT(longer->Pending(), SizeIs(1));
  EXPECT_FALSE(longer->Pending()[0].final);
  EXPECT_EQ(longer->Save().state.final_evaluation_steps(), 0) << "it was not evaluated";
}

}  // namespace
}  // namespace craftfleet
