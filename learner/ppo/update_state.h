// What an update changes.

#pragma once

#include <vector>

#include <absl/status/status.h>

#include "learner/ppo/adam.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// The optimisers of distillation's two losses, beside PPO's, over the same weights.
struct DistillationAdams {
  AdamState matching;
  AdamState prediction;
};

struct UpdateState {
  std::vector<float> weights;  // [param_count]
  AdamState adam;
  ValueNorm value_norm;
  DistillationAdams distillation;  // empty without distillation
};

// Of an update that was asked to stop.
inline absl::Status UpdateStopped() { return absl::CancelledError("the update was stopped; nothing is changed"); }

}  // namespace craftfleet
