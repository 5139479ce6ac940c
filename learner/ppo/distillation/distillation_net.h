// The network as distillation trains it: on the CPU in shards, or on a device. Does not include LibTorch.

#pragma once

#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "learner/ppo/distillation/distillation_loss.h"
#include "learner/ppo/distillation/kept_rollouts.h"

namespace craftfleet {

// Owned by one thread. Its functions return Internal if LibTorch failed, on a GPU errors as DeviceError
// (common/agent/device.h).
class DistillationNet {
 public:
  virtual ~DistillationNet() = default;

  // Rows are those of `rollouts`, which stay as they are until End.
  virtual absl::Status Begin(const KeptRollouts* rollouts) = 0;
  virtual void End() = 0;

  // float[rows,17] logits of rows, under the present weights.
  virtual absl::StatusOr<std::vector<float>> Logits(absl::Span<const int> rows) = 0;
  // The policy to keep from now on: float[n,17] logits of all rows of the rollouts.
  virtual absl::Status SetOldLogits(std::vector<float> logits) = 0;

  // float[pairs,F]: how features change from frame to frame (code_change.h), under the present weights; pairs are of
  // rows. Steps of matching that follow may name these changes.
  virtual absl::StatusOr<std::vector<float>> Changes(absl::Span<const FramePair> pairs) = 0;

  // Takes a step of the optimiser of `step.loss`. Does not wait for a device.
  //   DataLoss: the gradient is not finite. A device tells that in TakeLosses.
  virtual absl::Status Step(const DistillationStep& step) = 0;
  // The sums over the steps with `loss` since the last call. Waits for a device.   Errors as Step.
  virtual absl::StatusOr<DistillationLosses> TakeLosses(DistillationLoss loss) = 0;
};

}  // namespace craftfleet
