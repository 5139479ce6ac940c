// The episodes that `craftfleet eval` plays.

#ifndef CRAFTFLEET_DEPLOY_CLI_EVAL_EVAL_PLAN_H_
#define CRAFTFLEET_DEPLOY_CLI_EVAL_EVAL_PLAN_H_

#include <string>
#include <vector>

#include <absl/status/statusor.h>

#include "actor/evaluator.h"
#include "craftfleet/v1/checkpoint.pb.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// A set of episodes with a common result.
struct EvalPart {
  std::string name;  // "argmax", "sampled"
  EvaluationOptions options;
};

struct EvalPlan {
  v1::EnvConfig env;
  std::vector<EvalPart> parts;
};

// The final evaluation of the run that ends with the checkpoint `state`: the same episodes with the same results as in
// its final_argmax.jsonl and final_sampled.jsonl.
//   InvalidArgument: its configuration has no final evaluation.
absl::StatusOr<EvalPlan> FinalEvaluation(const v1::CheckpointState& state);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_EVAL_EVAL_PLAN_H_
