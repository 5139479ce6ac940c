// Recognises training that diverges: weights that are finite, but whose outputs are too large to play with. Includes
// LibTorch's tensors.

#pragma once

#include <cstdint>

#include <ATen/core/Tensor.h>
#include <absl/status/status.h>

#include "common/agent/nets/segments.h"
#include "learner/ppo/minibatches.h"
#include "learner/ppo/rollout.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// The steps on which new weights are tried out: the first of each segment, at most 64. Each stands alone.
Minibatch TrialSteps(const Rollout& rollout, bool has_segments);

// DataLoss: the norm of the gradient at an optimiser step, from 1, is not finite.
absl::Status CheckGradient(double norm, int64_t step);

// float[2]: the largest absolute value and logit. NaN if one is NaN.
at::Tensor LargestOutputs(const NetOutput& output);

// DataLoss: the largest value is beyond a tenth of what the learner `accepts` from actors, so that other steps stay
// within that, or one of the two is not finite.
absl::Status CheckOutputs(float largest_value, float largest_logit, const ValueRange& accepts);

}  // namespace craftfleet
