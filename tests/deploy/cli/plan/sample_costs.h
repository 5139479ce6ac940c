// Round costs for tests of plans.

#ifndef CRAFTFLEET_TESTS_DEPLOY_CLI_PLAN_SAMPLE_COSTS_H_
#define CRAFTFLEET_TESTS_DEPLOY_CLI_PLAN_SAMPLE_COSTS_H_

#include "common/config/config.h"
#include "deploy/cli/plan/costs.h"

namespace craftfleet {

// Of PPO-CNN: four epochs cost 800 us a step, actor and environment server together 80 us.
inline Costs SampleCosts() {
  Costs costs;
  costs.cpu = "a CPU";
  costs.build = "0.2.0 (abc)";
  costs.config = CostlyFields(*ResolveRunConfig(DefaultRunConfig()));
  costs.measured = "2026-01-02 03:04 UTC";
  costs.update_us = 200;
  costs.two_thread_us = 110;
  costs.act_us = 60;
  costs[FrameFormat::kRaw] = {/*server_us=*/12, /*game_us=*/6, /*actor_us=*/8, /*learner_us=*/4, /*bytes=*/12500};
  costs[FrameFormat::kLz4] = {/*server_us=*/20, /*game_us=*/6, /*actor_us=*/30, /*learner_us=*/11, /*bytes=*/1200};
  costs[FrameFormat::kScene] = {/*server_us=*/8, /*game_us=*/4, /*actor_us=*/12, /*learner_us=*/10, /*bytes=*/100};
  costs.weight_bytes = 2.5e6;
  return costs;
}

// 4 epochs, 16 lanes in tiles of 8, minibatches of 128 in 2 shards, rollouts of 4096 steps.
inline v1::RunConfig SampleConfig() { return *ResolveRunConfig(DefaultRunConfig()); }

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_DEPLOY_CLI_PLAN_SAMPLE_COSTS_H_
