#include "learner/fleet_summary.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

void AddWorker(const std::string& role, v1::Peer::Health health, double rate, int threads, double inference,
               v1::StatusReply* reply) {
  v1::Peer* peer = reply->add_peers();
  peer->set_role(role);
  peer->set_health(health);
  peer->mutable_summary()->set_steps_per_second(rate);
  peer->mutable_summary()->set_threads(threads);
  v1::ActivityTime* time = peer->mutable_summary()->add_times();
  time->set_activity("inference");
  time->set_share(inference);
}

TEST(ViewFleet, CountsAnsweringWorkersAndWeighsActorsByThreads) {
  v1::StatusReply reply;
  AddWorker("actor", v1::Peer::OK, 100, 1, 0.5, &reply);
  AddWorker("actor", v1::Peer::OK, 300, 4, 0.25, &reply);
  AddWorker("actor", v1::Peer::LOST, 300, 4, 1, &reply);
  AddWorker("envserver", v1::Peer::OK, 400, 5, 0, &reply);
  AddWorker("envserver", v1::Peer::LOST, 400, 5, 0, &reply);
  AddWorker("envserver", v1::Peer::NOT_ANSWERING, 400, 5, 0, &reply);
  AddWorker("envserver", v1::Peer::LEFT, 400, 5, 0, &reply);
  Work trainer;
  trainer.times[Activity::kUpdate] = 9;
  const FleetView view = ViewFleet(trainer, reply);
  EXPECT_EQ(view.actors, 2);
  EXPECT_EQ(view.env_servers, 1);
  EXPECT_EQ(view.lost_env_servers, 2) << "one lost, one that does not answer";
  EXPECT_EQ(view.steps_per_second, 400);
  EXPECT_DOUBLE_EQ(view.actors_times[Activity::kInference], 1.5);
  EXPECT_EQ(view.learner[Activity::kUpdate], 9);
  EXPECT_FALSE(view.early);
  EXPECT_TRUE(ViewFleet(Work(), reply).early) << "no update yet";
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
