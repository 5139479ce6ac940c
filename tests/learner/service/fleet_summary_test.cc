#include "learner/service/fleet_summary.h"

#include <memory>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using Health = WorkerRegistry::Health;

WorkerRegistry::WorkerInfo WorkerOf(WorkerRole role, Health health, double rate, int threads, double inference) {
  auto summary = std::make_shared<v1::ProcessSummary>();
  summary->set_steps_per_second(rate);
  summary->set_threads(threads);
  v1::ActivityTime* time = summary->add_times();
  time->set_activity("inference");
  time->set_share(inference);
  WorkerRegistry::WorkerInfo info;
  info.worker.role = role;
  info.worker.summary = std::move(summary);
  info.health = health;
  return info;
}

TEST(ViewFleet, CountsAnsweringWorkersAndWeighsActorsByThreads) {
  const std::vector<WorkerRegistry::WorkerInfo> workers = {
      WorkerOf(WorkerRole::kActor, Health::kOk, 100, 1, 0.5),
      WorkerOf(WorkerRole::kActor, Health::kOk, 300, 4, 0.25),
      WorkerOf(WorkerRole::kActor, Health::kLost, 300, 4, 1),
      WorkerOf(WorkerRole::kEnvServer, Health::kOk, 400, 5, 0),
      WorkerOf(WorkerRole::kEnvServer, Health::kLost, 400, 5, 0),
      WorkerOf(WorkerRole::kEnvServer, Health::kNotAnswering, 400, 5, 0),
      WorkerOf(WorkerRole::kEnvServer, Health::kLeft, 400, 5, 0)};
  Work trainer;
  trainer.times[Activity::kUpdate] = 9;
  const FleetView view = ViewFleet(trainer, workers);
  EXPECT_EQ(view.actors, 2);
  EXPECT_EQ(view.env_servers, 1);
  EXPECT_EQ(view.lost_env_servers, 2) << "one lost, one that does not answer";
  EXPECT_EQ(view.steps_per_second, 400);
  EXPECT_DOUBLE_EQ(view.actors_times[Activity::kInference], 1.5);
  EXPECT_EQ(view.learner[Activity::kUpdate], 9);
  EXPECT_FALSE(view.early);
  EXPECT_TRUE(ViewFleet(Work(), workers).early) << "no update yet";
}

TEST(ViewFleet, ASlowServerAnswersAndIsNamed) {
  WorkerRegistry::WorkerInfo slow = WorkerOf(WorkerRole::kEnvServer, Health::kSlow, 1, 1, 0);
  slow.worker.address = "a:1";
  slow.worker.step_ms = 430;
  const FleetView view = ViewFleet(Work(), {slow, WorkerOf(WorkerRole::kEnvServer, Health::kOk, 1, 1, 0)});
  EXPECT_EQ(view.env_servers, 2);
  EXPECT_EQ(view.lost_env_servers, 0);
  EXPECT_EQ(view.slow_env_servers, std::vector<std::string>{"a:1 (430 ms a step)"});
}

TEST(CountWorkers, CountsByRoleAndHealth) {
  v1::FleetSummary summary;
  CountWorkers(
      {WorkerOf(WorkerRole::kActor, Health::kOk, 1, 1, 0), WorkerOf(WorkerRole::kActor, Health::kLost, 1, 1, 0),
       WorkerOf(WorkerRole::kActor, Health::kOk, 1, 1, 0), WorkerOf(WorkerRole::kEnvServer, Health::kOk, 1, 1, 0)},
      &summary);
  ASSERT_EQ(summary.workers_size(), 3);
  EXPECT_EQ(summary.workers(0).role(), "actor");
  EXPECT_EQ(summary.workers(0).health(), v1::Peer::OK);
  EXPECT_EQ(summary.workers(0).number(), 2);
  EXPECT_EQ(summary.workers(1).health(), v1::Peer::LOST);
  EXPECT_EQ(summary.workers(2).role(), "envserver");
}

TEST(SummarizeFleet, ContainsTimesBottleneckAndAdvice) {
  FleetView view;
  view.actors = 1;
  view.steps_per_second = 1;
  view.learner[Activity::kUpdate] = 8;
  view.learner[Activity::kIntake] = 2;
  view.actors_times[Activity::kInference] = 1;
  const v1::FleetSummary summary = SummarizeFleet(view);
  EXPECT_EQ(summary.bottleneck(), "learner");
  EXPECT_THAT(summary.advice(), testing::HasSubstr("80%"));
  ASSERT_EQ(summary.times_size(), 2);
  EXPECT_EQ(summary.times(0).activity(), "inference");
  EXPECT_NEAR(summary.times(0).share(), 0.2, 1e-12);
  EXPECT_EQ(summary.times(1).activity(), "update");
}

TEST(SummarizeFleet, ShowsTheStateOfTheRun) {
  FleetView view;
  view.actors = 1;
  EXPECT_EQ(SummarizeFleet(view).run_state(), v1::FleetSummary::TRAINING);
  view.paused = true;
  EXPECT_EQ(SummarizeFleet(view).run_state(), v1::FleetSummary::PAUSED);
  view.paused = false;
  view.evaluating = true;
  EXPECT_EQ(SummarizeFleet(view).run_state(), v1::FleetSummary::EVALUATING);
  EXPECT_EQ(SummarizeFleet(view).bottleneck(), "none");
  EXPECT_THAT(SummarizeFleet(view).advice(), testing::HasSubstr("final evaluation is being played"));
  view.actors = 0;
  EXPECT_EQ(SummarizeFleet(view).bottleneck(), "actors") << "the run waits for them";
  view.finished = true;
  EXPECT_EQ(SummarizeFleet(view).run_state(), v1::FleetSummary::COMPLETE);
}

}  // namespace
}  // namespace craftfleet
