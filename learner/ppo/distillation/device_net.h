// Distillation's network on a device. Includes LibTorch's tensors.

#pragma once

#include <cstdint>
#include <vector>

#include <ATen/core/Tensor.h>
#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>
#include <c10/core/Device.h>

#include "common/agent/agent_spec.h"
#include "common/agent/nets/network.h"
#include "common/agent/nets/segments.h"
#include "learner/ppo/device_adam.h"
#include "learner/ppo/device_weights.h"
#include "learner/ppo/distillation/distillation_net.h"

namespace craftfleet {

// The rollouts of a phase go to the device at its beginning. Losses are computed there; a step of matching waits once,
// for the changes that its goals are matched by, and a step of prediction never.
class DeviceNet final : public DistillationNet {
 public:
  // Trains `weights`, with an optimiser for each loss; all outlive the object.
  DeviceNet(const AgentSpec& spec, at::Device device, DeviceWeights* weights, DeviceAdam* matching,
            DeviceAdam* prediction);

  absl::Status Begin(const KeptRollouts* rollouts) override;
  void End() override;
  absl::StatusOr<std::vector<float>> Logits(absl::Span<const int> rows) override;
  absl::Status SetOldLogits(std::vector<float> logits) override;
  absl::StatusOr<std::vector<float>> Changes(absl::Span<const FramePair> pairs) override;
  absl::Status Step(const DistillationStep& step) override;
  absl::StatusOr<DistillationLosses> TakeLosses(DistillationLoss loss) override;

 private:
  at::Tensor Frames(const at::Tensor& rows) const;  // float[n,H,W,3] in 0..1
  // float[rows,width] of all rows, computed without gradients, some at a time. `compute` takes rows on the device.
  template <typename Compute>
  at::Tensor ComputeAll(absl::Span<const int> rows, const Compute& compute) const;
  // `table`, float[n,width], on the host. Waits for the device.
  std::vector<float> Fetch(const at::Tensor& table) const;
  NetOutput Forward(const at::Tensor& rows, bool predicts) const;
  at::Tensor* SumsOf(DistillationLoss loss) {
    return loss == DistillationLoss::kMatching ? &matching_sums_ : &prediction_sums_;
  }

  const AgentSpec spec_;
  const at::Device device_;
  const Network network_;
  DeviceWeights* const weights_;
  DeviceAdam* const matching_;
  DeviceAdam* const prediction_;

  // Between Begin and End, on the device. Of all rows of the rollouts:
  at::Tensor frames_;         // uint8[n,H,W,3]
  at::Tensor memories_;       // float[n,state_size]
  at::Tensor actions_;        // float[n,17], 1 at the action
  at::Tensor old_log_probs_;  // double[n,17] of the policy to keep

  at::Tensor changes_;          // float[pairs,F] that Changes computed last
  at::Tensor matching_sums_;    // double[4] the fields of DistillationLosses
  at::Tensor prediction_sums_;  // likewise
};

}  // namespace craftfleet
