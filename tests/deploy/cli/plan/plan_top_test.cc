// What craftfleet plan says beforehand, craftfleet top says of the running fleet.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "deploy/cli/plan/planner.h"
#include "learner/fleet_summary.h"
#include "tests/deploy/cli/plan/sample_costs.h"

namespace craftfleet {
namespace {

// The status of a learner whose fleet runs exactly as planned.
v1::StatusReply StatusOf(const FleetPlan& plan) {
  v1::StatusReply reply;
  const ByActivity shares = plan.view.actors_times.Normalized();
  for (int i = 0; i < plan.actors; ++i) {
    v1::Peer* actor = reply.add_peers();
    actor->set_role("actor");
    actor->set_health(v1::Peer::OK);
    actor->mutable_summary()->set_threads(plan.actor_threads / plan.actors);
    actor->mutable_summary()->set_steps_per_second(plan.steps_per_second / plan.actors);
    for (const Activity activity : kActivities) {
      v1::ActivityTime* time = actor->mutable_summary()->add_times();
      time->set_activity(std::string(ActivityName(activity)));
      time->set_share(shares[activity]);
    }
  }
  for (int i = 0; i < plan.env_servers; ++i) {
    v1::Peer* server = reply.add_peers();
    server->set_role("envserver");
    server->set_health(v1::Peer::OK);
  }
  return reply;
}

TEST(PlanAndTop, GiveTheSameAdvice) {
  for (const double act_us : {1.0, 60.0, 5000.0}) {
    for (const double game_us : {6.0, 4000.0}) {
      for (const int overlap : {0, 1}) {
        for (const int cores : {1, 2, 3, 8}) {
          Costs costs = SampleCosts();
          costs.act_us = act_us;
          costs[FrameFormat::kRaw].game_us = game_us;
          costs[FrameFormat::kRaw].server_us = 2 * game_us;
          v1::RunConfig config = SampleConfig();
          config.set_overlap(overlap);
          config.set_lanes(64);
          const FleetPlan plan = PlanFleet(costs, config, FrameFormat::kRaw, {cores, cores});
          Work trainer;
          trainer.times = plan.view.learner;
          FleetView seen = ViewFleet(trainer, StatusOf(plan));
          seen.plays_on = overlap > 0;
          const v1::FleetSummary shown = SummarizeFleet(seen);
          EXPECT_EQ(shown.bottleneck(), plan.limit.part);
          EXPECT_EQ(shown.advice(), plan.limit.advice);
        }
      }
    }
  }
}

}  // namespace
}  // namespace craftfleet
