// The update on a device: weights, optimiser and rollout stay in its memory. Equations: PPO.md. Includes LibTorch's
// tensors.

#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <ATen/core/Tensor.h>
#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <c10/core/Device.h>

#include "common/agent/agent_spec.h"
#include "common/agent/device_snapshot.h"
#include "common/agent/nets/network.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/device_adam.h"
#include "learner/ppo/device_rollout.h"
#include "learner/ppo/device_weights.h"
#include "learner/ppo/distillation/distillation_net.h"
#include "learner/ppo/lag_correction.h"
#include "learner/ppo/minibatches.h"
#include "learner/ppo/rollout.h"
#include "learner/ppo/update_state.h"
#include "learner/ppo/update_stats.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// Runs the minibatches of an iteration on a device, where weights and optimiser stay. The rollout goes there once an
// iteration, and statistics come back once; the rest comes when somebody wants it. In between the host only starts
// computations: it copies nothing and waits for nothing. Computes what the CPU's updater computes (ppo_updater.h) but
// for rounding: a minibatch is one part, not `gradient_shards` parts. Used by one thread.
class DeviceUpdate {
 public:
  // `config` as PpoUpdater::Create has it. Allocates nothing on the device yet.
  DeviceUpdate(AgentSpec spec, const v1::RunConfig& config, at::Device device);

  // What follows PPO's epochs in an iteration: takes the rollout that they learned from, maybe corrected, and adds to
  // the statistics.
  using AfterEpochs = std::function<absl::Status(const Rollout&, UpdateStats*)>;

  // Takes optimiser steps over `epochs`, each epoch's minibatches of `rollout` in order; the first Run after Forget, or
  // of all, begins with `state`. Then `state` has the value normaliser and the optimisers' numbers of steps; weights()
  // and FetchMoments have the rest. `should_stop` is asked after each minibatch. Unless OK, all is as before; if the
  // device fails so that it can't be, every later call has that error. `after_epochs`: null: nothing.
  //   Cancelled: should_stop() said so.   DataLoss: gradient or weights are not finite, or training diverges
  //   (divergence.h).   ResourceExhausted: the device's memory does not suffice; says what to lower.   Others as
  //   DeviceError (common/agent/device.h), or of `after_epochs`.
  absl::StatusOr<UpdateStats> Run(const Rollout& rollout, const std::vector<std::vector<Minibatch>>& epochs,
                                  const std::function<bool()>& should_stop, const AfterEpochs& after_epochs,
                                  UpdateState* state);

  // The weights after the last Run that was OK; null: those of the next Run's `state`.
  const std::shared_ptr<const DeviceSnapshot>& weights() const { return snapshot_; }

  // Copies the optimisers' moments after the last Run that was OK to its `state`. Waits for the device.
  //   As DeviceError.
  absl::Status FetchMoments(UpdateState* state) const;

  // For `after_epochs`: the value normaliser, which is fetched and sent, and a network that trains the weights. Throw
  // c10::Error.
  ValueNorm FetchValueNorm() const;
  void SendValueNorm(const ValueNorm& norm);
  // Used by `after_epochs` alone. This object outlives it.
  std::unique_ptr<DistillationNet> MakeDistillationNet();

  // The next Run sends its `state` to the device again.
  void Forget() { snapshot_ = nullptr; }

 private:
  // Sends `state` to the device.
  void Load(const UpdateState& state);
  // `norm`: the value normaliser after it.
  absl::StatusOr<UpdateStats> RunEpochs(const Rollout& rollout, const std::vector<std::vector<Minibatch>>& epochs,
                                        const std::function<bool()>& should_stop, const AfterEpochs& after_epochs,
                                        ValueNorm* norm);
  // Returns to the state before this Run. If the device fails, sets `lost_`.
  void Undo(const ValueNorm& norm);
  NetOutput Forward(const DeviceRollout& rollout, const DeviceMinibatch& minibatch,
                    const std::optional<Dropout>& dropout) const;
  // LargestOutputs of the present weights for the steps of `trial`: double[2].
  at::Tensor TryWeights(const DeviceRollout& rollout, const DeviceMinibatch& trial) const;
  // What the network says about the rows of `minibatch`: float[m,2], log-probabilities of the actions and values, not
  // normalised.
  at::Tensor OutputsOf(const DeviceRollout& rollout, const DeviceMinibatch& minibatch, const NetOutput& output) const;
  // ValueNorm::Scale now: double.
  struct DeviceScale {
    at::Tensor mean;
    at::Tensor deviation;
  };
  DeviceScale value_scale() const;
  // With advantages_over_rollout.
  void NormaliseOverRollout(DeviceRollout* rollout) const;
  // `outputs` float[n+1,2] of all rows and the padding, on the host. Waits for the device.
  static StartOutputs FetchStart(const at::Tensor& outputs);
  // One optimiser step. `start` float[n+1,2] gets OutputsOf; undefined: they are not wanted. Returns double[6]: the
  // means of the losses, as DeviceLoss has them, and the norm of the gradient.
  at::Tensor RunMinibatch(const DeviceRollout& rollout, const DeviceMinibatch& minibatch, const at::Tensor& start);
  // Adds returns float[n] to the value normaliser, and returns them normalised.
  at::Tensor NormaliseReturns(const at::Tensor& returns);
  const AgentSpec spec_;
  const v1::PpoConfig config_;
  const uint64_t seed_;
  const bool corrects_lag_;
  const at::Device device_;
  const Network network_;

  std::shared_ptr<const DeviceSnapshot> snapshot_;  // null: the following is not loaded
  absl::Status lost_;                               // OK, or why the following is not the state after the last Run
  DeviceWeights weights_;
  std::vector<DeviceAdam> adams_;  // PPO's; with distillation also those of matching and prediction
  at::Tensor value_norm_;          // double[2] the normaliser's mean and mean square, not corrected
  double value_weight_ = 0;        // and its weight
};

}  // namespace craftfleet
