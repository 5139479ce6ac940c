#include "learner/service/fleet_summary.h"

#include <memory>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/telemetry/metric_table.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

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
  EXPECT_THAT(summary.advice(), HasSubstr("80%"));
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
  EXPECT_THAT(SummarizeFleet(view).advice(), HasSubstr("final evaluation is being played"));
  view.actors = 0;
  EXPECT_EQ(SummarizeFleet(view).bottleneck(), "actors") << "the run waits for them";
  view.finished = true;
  EXPECT_EQ(SummarizeFleet(view).run_state(), v1::FleetSummary::COMPLETE);
}

// A fleet whose learner waits `intake` of 10 s, with the given times of its actors.
FleetView Fleet(double intake, double environment, double wire, double inference, double permits) {
  FleetView view;
  view.actors = 2;
  view.env_servers = 2;
  view.steps_per_second = 1000;
  view.learner[Activity::kIntake] = intake;
  view.learner[Activity::kUpdate] = 9 - intake;
  view.learner[Activity::kOther] = 1;
  view.actors_times[Activity::kEnvironment] = environment;
  view.actors_times[Activity::kWire] = wire;
  view.actors_times[Activity::kInference] = inference;
  view.actors_times[Activity::kPermits] = permits;
  return view;
}

TEST(FleetTimes, TheLearnersWaitIsDividedByTheActorsActivities) {
  // Actors wait half the time, which is as long as the learner works, so this waiting is not counted.
  const ByActivity times = FleetTimes(Fleet(5, 3, 0.5, 1.5, 5));
  EXPECT_NEAR(times[Activity::kUpdate], 0.4, 1e-12);
  EXPECT_NEAR(times[Activity::kOther], 0.1, 1e-12);
  EXPECT_NEAR(times[Activity::kEnvironment], 0.3, 1e-12);
  EXPECT_NEAR(times[Activity::kWire], 0.05, 1e-12);
  EXPECT_NEAR(times[Activity::kInference], 0.15, 1e-12);
  EXPECT_NEAR(times[Activity::kPermits], 0, 1e-12);
  EXPECT_EQ(times[Activity::kIntake], 0);
  EXPECT_NEAR(times.Sum(), 1, 1e-12);
}

TEST(FleetTimes, WaitingForPermitsBeyondTheLearnersWorkCounts) {
  // The learner works 10% of the time and actors wait 70%, so 60% count as waiting for permits.
  const ByActivity times = FleetTimes(Fleet(9, 2, 0, 1, 7));
  EXPECT_NEAR(times[Activity::kPermits], 0.9 * 0.6 / 0.9, 1e-12);
  EXPECT_NEAR(times.Sum(), 1, 1e-12);
}

TEST(FleetTimes, WithoutPlayTheLearnerWaits) {
  EXPECT_NEAR(FleetTimes(Fleet(9, 0, 0, 0, 10))[Activity::kIntake], 0.9, 1e-12);
  EXPECT_EQ(FleetTimes(FleetView()).Sum(), 0);
}

// The actors that wait for it also wait for permits: the advice was to run fewer of them.
TEST(FindBottleneck, ASlowServerIsNamedWhateverElseTakesLong) {
  for (FleetView view : {Fleet(9, 2, 0, 1, 7), Fleet(1, 1, 0, 1, 8), FleetView(Fleet(5, 3, 0.5, 1.5, 5))}) {
    view.env_servers = 2;
    view.slow_env_servers = {"10.0.0.7:50061 (430 ms a step)"};
    EXPECT_EQ(FindBottleneck(view).part, "environment");
    EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("Environment server 10.0.0.7:50061 (430 ms a step) is slow: "));
    view.slow_env_servers.emplace_back("another");
    EXPECT_THAT(FindBottleneck(view).advice, HasSubstr(" is slow, as is 1 more: "));
    view.slow_env_servers.emplace_back("a third");
    EXPECT_THAT(FindBottleneck(view).advice, HasSubstr(" is slow, as are 2 more: "));
  }
}

TEST(FindBottleneck, NamesTheLargestPartAndWhatToAdd) {
  const struct {
    FleetView view;
    std::string part;
    std::string advice;
  } cases[] = {
      {Fleet(1, 1, 0, 1, 8), "learner", "The learner works 90% of the time: give it more or faster CPUs"},
      {Fleet(9, 7, 1, 1, 1), "environment", "Games take 70% of the time: add environment servers."},
      {Fleet(9, 1, 1, 7, 1), "inference", "inference takes 70% of the time: add actors."},
      {Fleet(9, 1, 7, 1, 1), "wire", "Messages take 70% of the time: add actors, whose waits overlap"},
      {Fleet(9, 1, 0, 1, 8), "permits", "Actors wait for lanes 70% of the time"},
  };
  for (const auto& c : cases) {
    const Bottleneck found = FindBottleneck(c.view);
    EXPECT_EQ(found.part, c.part);
    EXPECT_THAT(found.advice, HasSubstr(c.advice));
  }
}

// Faster play helps more than a faster learner, even if each part of play is smaller than the learner's.
TEST(FindBottleneck, ALearnerThatWaitsMoreThanItWorksIsNotTheBottleneck) {
  EXPECT_EQ(FindBottleneck(Fleet(5.5, 2, 2, 3, 4.5)).part, "inference");
  EXPECT_EQ(FindBottleneck(Fleet(4.5, 2, 2, 3, 4.5)).part, "learner");
}

// The wait counted as the learner's work.
TEST(FindBottleneck, ALearnerThatWaitsForEvaluationsNeedsActors) {
  FleetView view = Fleet(1, 1, 0, 1, 8);
  view.learner[Activity::kIdle] = 30;
  EXPECT_EQ(FindBottleneck(view).part, "actors");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("Training waits for evaluations 75% of the time: add actors"));
  view.learner[Activity::kIdle] = 5;
  EXPECT_EQ(FindBottleneck(view).part, "learner");
}

// With overlap the learner may work most of the time and still wait for actors that never wait.
TEST(FindBottleneck, WherePlayGoesOnDuringUpdatesTheBusierSideIsTheBottleneck) {
  FleetView view = Fleet(4, 1, 0, 8.5, 0.5);
  EXPECT_EQ(FindBottleneck(view).part, "learner") << "they take turns";
  view.plays_on = true;
  EXPECT_EQ(FindBottleneck(view).part, "inference") << "the learner works 60% of the time, actors 95%";
  view = Fleet(0.5, 1, 0, 5, 4);
  view.plays_on = true;
  EXPECT_EQ(FindBottleneck(view).part, "learner") << "95% and 60%";
  view = Fleet(8, 0.5, 0, 1, 8.5);
  view.plays_on = true;
  EXPECT_EQ(FindBottleneck(view).part, "permits") << "both wait";
}

TEST(FindBottleneck, AMissingPartComesFirst) {
  FleetView view = Fleet(9, 0, 0, 0, 0);
  view.steps_per_second = 0;
  view.env_servers = 0;
  view.lost_env_servers = 2;
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("No environment server answers (2 lost)"));
  view.lost_env_servers = 0;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("start craftfleet-envserver"));
  view.actors = 0;
  EXPECT_EQ(FindBottleneck(view).part, "actors");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("start craftfleet-actor"));
  view.paused = true;
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("Play is paused"));
  view.finished = true;
  EXPECT_EQ(FindBottleneck(view).advice, "The run is complete.");
}

TEST(FindBottleneck, AFleetWhoseWorkersAreAllDrainedLacksThem) {
  FleetView view = Fleet(9, 0, 0, 0, 9);
  view.steps_per_second = 0;
  view.drained_actors = 1;
  view.drained_env_servers = 1;
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("check the actors' logs")) << "one of two still gets work";
  view.drained_env_servers = 2;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("All environment servers are drained: start another one"));
  view.drained_actors = 2;
  EXPECT_EQ(FindBottleneck(view).part, "actors");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("All actors are drained: start another one"));
  view.evaluating = true;
  EXPECT_EQ(FindBottleneck(view).part, "actors") << "the evaluation waits for one, too";
}

TEST(FindBottleneck, LostServersAreMentionedIfTheyMatter) {
  FleetView view = Fleet(9, 7, 1, 1, 1);
  view.env_servers = 1;
  view.lost_env_servers = 1;
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("add environment servers (1 of 2 lost)."));
}

// The rate covers the last 20 seconds, and the actors' waiting for the server looks like waiting for permits.
TEST(FindBottleneck, TheOnlyServerIsReportedMissingAsSoonAsItIsLost) {
  FleetView view = Fleet(9, 1, 0, 1, 8);
  view.env_servers = 0;
  view.lost_env_servers = 1;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("start craftfleet-envserver again; the actors wait for one"));
  view.evaluating = true;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers") << "an evaluation also waits for a server";
}

TEST(FindBottleneck, BeforeTheFirstIterationThereIsNoAdvice) {
  FleetView view = Fleet(9.9, 0, 1, 0, 9);
  view.early = true;
  EXPECT_EQ(FindBottleneck(view).part, "none");
  EXPECT_THAT(FindBottleneck(view).advice, HasSubstr("No iteration has ended yet"));
  view.env_servers = 0;
  view.steps_per_second = 0;
  EXPECT_EQ(FindBottleneck(view).part, "environment servers") << "missing parts are reported anyway";
}

TEST(FindBottleneck, IdleActorsAreNotReportedAsTooMany) {
  FleetView view = Fleet(9, 0, 0, 0, 9);
  view.steps_per_second = 0;
  EXPECT_THAT(FindBottleneck(view).advice,
              HasSubstr("The actors play nothing although 2 environment servers answer: check the actors' logs"));
  // No actor plays during a long update.
  view.learner[Activity::kUpdate] = 20;
  EXPECT_EQ(FindBottleneck(view).part, "learner");
}

TEST(FindBottleneck, GivesNoAdviceTooEarly) {
  FleetView view = Fleet(0, 1, 1, 1, 1);
  view.learner = ByActivity();
  view.learner[Activity::kUpdate] = 1;
  EXPECT_EQ(FindBottleneck(view).part, "none");
}

TEST(FindBottleneck, AllAdviceIsOneSentence) {
  for (int mask = 0; mask < 32; ++mask) {
    FleetView view = Fleet(mask % 10, mask & 1, mask & 2, mask & 4, mask & 8);
    view.actors = mask & 16;
    const Bottleneck bottleneck = FindBottleneck(view);
    EXPECT_THAT(kBottleneckParts, testing::Contains(absl::string_view(bottleneck.part)));
    const std::string& advice = bottleneck.advice;
    ASSERT_FALSE(advice.empty());
    EXPECT_EQ(advice.find(". "), std::string::npos) << advice;
    EXPECT_EQ(advice.back(), '.') << advice;
  }
}

}  // namespace
}  // namespace craftfleet
