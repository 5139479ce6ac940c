#include "deploy/cli/eval/eval_plan.h"

#include <algorithm>
#include <cstdint>

#include <absl/status/status.h>

namespace craftfleet {

absl::StatusOr<EvalPlan> FinalEvaluation(const v1::CheckpointState& state) {
  const v1::EvalConfig& eval = state.config().eval();
  if (eval.final_episodes() == 0) {
    return absl::InvalidArgumentError(
        "the run has no final evaluation (eval.final_episodes is 0 in its configuration): give --episodes instead");
  }
  EvalPlan plan;
  plan.env = state.config().env();
  plan.env.set_name(eval.env());
  EvaluationOptions options;
  options.seed = eval.seed();
  options.episodes = eval.final_episodes();
  options.first_episode = std::max<int64_t>(state.next_eval_episode(), 1);
  options.greedy = true;
  plan.parts.push_back({"argmax", options});
  options.first_episode += options.episodes;
  options.greedy = false;
  plan.parts.push_back({"sampled", options});
  return plan;
}

}  // namespace craftfleet
