// Which episodes `craftfleet eval` plays.

#ifndef CRAFTFLEET_DEPLOY_EVAL_EVAL_PLAN_H_
#define CRAFTFLEET_DEPLOY_EVAL_EVAL_PLAN_H_

#include <string>
#include <vector>

#include <absl/status/statusor.h>

#include "actor/evaluator.h"
#include "craftfleet/v1/checkpoint.pb.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// Episodes that are counted together.
struct EvalPart {
  std::string name;  // "argmax", "sampled"
  EvaluationOptions options;
};

struct EvalPlan {
  v1::EnvConfig env;
  std::vector<EvalPart> parts;
};

// What the run of `state` plays as its final evaluation when it ends with this checkpoint: the same episodes with the
// same result as in its final_argmax.jsonl and final_sampled.jsonl.
//   InvalidArgument: its configuration has no final evaluation.
absl::StatusOr<EvalPlan> FinalEvaluation(const v1::CheckpointState& state);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_EVAL_EVAL_PLAN_H_
