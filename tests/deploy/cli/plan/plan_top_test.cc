// What craftfleet plan says beforehand, craftfleet top says of the running fleet.

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "deploy/cli/plan/planner.h"
#include "learner/fleet_summary.h"
#include "tests/deploy/cli/plan/sample_costs.h"

namespace craftfleet {
namespace {

// The workers of a fleet that runs exactly as planned.
std::vector<WorkerRegistry::Glance> WorkersOf(const FleetPlan& plan) {
  std::vector<WorkerRegistry::Glance> workers;
  const ByActivity shares = plan.view.actors_times.Normalized();
  for (int i = 0; i < plan.actors; ++i) {
    auto summary = std::make_shared<v1::ProcessSummary>();
    summary->set_threads(plan.actor_threads / plan.actors);
    summary->set_steps_per_second(plan.steps_per_second / plan.actors);
    for (const Activity activity : kActivities) {
      v1::ActivityTime* time = summary->add_times();
      time->set_activity(std::string(ActivityName(activity)));
      time->set_share(shares[activity]);
    }
    workers.push_back({WorkerRole::kActor, WorkerRegistry::Health::kOk, /*drained=*/false, std::move(summary)});
  }
  for (int i = 0; i < plan.env_servers; ++i) workers.push_back({WorkerRole::kEnvServer});
  return workers;
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
          FleetView seen = ViewFleet(trainer, WorkersOf(plan));
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
