// Adam on a device. Equations: PPO.md, adam.h. Includes LibTorch's tensors.

#pragma once

#include <cstdint>

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/adam.h"

namespace craftfleet {

// The optimiser of one flat array of weights; moments and the number of steps stay on the device. Its functions throw
// c10::Error. Used by one thread.
class DeviceAdam {
 public:
  // The fields of `config` that count: as AdamStep.
  explicit DeviceAdam(const v1::PpoConfig& config) : config_(config) {}

  // Goes on from `state`, whose moments go to `device`, and keeps it.
  void Load(const AdamState& state, at::Device device);

  // Keeps the present state, in as much memory again, for Undo. Allocates nothing.
  void Keep();
  // Returns to the state that was kept last.
  void Undo();

  // Takes one step on `weights`, float[n], in place. `gradient` is that of the first k of them, float[k]; the others
  // stay as they are. It is clipped by its norm, and may be changed. Returns its norm before: double[]. Waits for
  // nothing.
  at::Tensor Step(const at::Tensor& gradient, const at::Tensor& weights);

  // float[n]
  const at::Tensor& exp_avg() const { return exp_avg_; }
  const at::Tensor& exp_avg_sq() const { return exp_avg_sq_; }
  int64_t steps() const { return steps_; }

 private:
  // float[k] each.
  struct Parts {
    at::Tensor gradient, weights, exp_avg, exp_avg_sq;
  };
  // By one computation for clipping, moments and weights, which reads and writes each number once.
  void StepFused(const Parts& parts, const at::Tensor& norm);
  void StepApart(const Parts& parts, const at::Tensor& norm);

  const v1::PpoConfig config_;
  at::Tensor exp_avg_;
  at::Tensor exp_avg_sq_;
  int64_t steps_ = 0;
  at::Tensor device_steps_;  // float[] the same
  at::Tensor kept_avg_;
  at::Tensor kept_avg_sq_;
  int64_t kept_steps_ = 0;
};

}  // namespace craftfleet
