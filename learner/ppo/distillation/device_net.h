// Distillation's network on a device. Includes LibTorch's tensors.

#ifndef CRAFTFLEET_LEARNER_PPO_DISTILLATION_DEVICE_NET_H_
#define CRAFTFLEET_LEARNER_PPO_DISTILLATION_DEVICE_NET_H_

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

// The rollouts of a phase go to the device at its beginning. A step fetches the outputs of its rows and sends the
// gradients by them, since the losses are computed on the host.
class DeviceNet final : public DistillationNet {
 public:
  // Trains `weights`, with an optimiser for each loss; all outlive the object.
  DeviceNet(const AgentSpec& spec, at::Device device, DeviceWeights* weights, DeviceAdam* matching,
            DeviceAdam* prediction);

  absl::Status Begin(const KeptRollouts* rollouts) override;
  void End() override;
  absl::StatusOr<std::vector<float>> Codes(absl::Span<const int> rows) override;
  absl::StatusOr<std::vector<float>> Logits(absl::Span<const int> rows) override;
  absl::StatusOr<NetNumbers> Forward(absl::Span<const int> rows, bool predicts) override;
  absl::StatusOr<double> Step(const NetNumbers& gradients, DistillationLoss loss) override;

 private:
  at::Tensor SendRows(absl::Span<const int> rows) const;  // int64[n] on the device
  at::Tensor Frames(const at::Tensor& rows) const;        // float[n,H,W,3] in 0..1
  // `outputs`, float[n,width], on the host. Waits for the device.
  at::Tensor Fetch(const at::Tensor& outputs) const;
  // float[rows,width] of all rows, computed without gradients, some at a time. `compute` takes rows on the device.
  template <typename Compute>
  absl::StatusOr<std::vector<float>> ComputeAll(absl::Span<const int> rows, const Compute& compute) const;

  const AgentSpec spec_;
  const at::Device device_;
  const Network network_;
  const int code_size_;
  DeviceWeights* const weights_;
  DeviceAdam* const matching_;
  DeviceAdam* const prediction_;

  // Of all rows of the rollouts, between Begin and End.
  at::Tensor frames_;    // uint8[n,H,W,3]
  at::Tensor memories_;  // float[n,state_size]
  at::Tensor actions_;   // float[n,17], 1 at the action
  NetOutput output_;     // of the last Forward
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_DISTILLATION_DEVICE_NET_H_
