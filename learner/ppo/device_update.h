// The update on a device: weights, optimiser and rollout stay in its memory. Equations: PPO.md. Includes LibTorch's
// tensors.

#ifndef CRAFTFLEET_LEARNER_PPO_DEVICE_UPDATE_H_
#define CRAFTFLEET_LEARNER_PPO_DEVICE_UPDATE_H_

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

// Runs the minibatches of an iteration on a device. The rollout goes there once an iteration; weights, optimiser and
// statistics come back once. In between the host only starts computations: it copies nothing and waits for nothing.
// Computes what the CPU's updater computes (ppo_updater.h) but for rounding: a minibatch is one part, not
// `gradient_shards` parts. Used by one thread.
class DeviceUpdate {
 public:
  // `config` as PpoUpdater::Create has it. Allocates nothing on the device yet.
  DeviceUpdate(AgentSpec spec, const v1::RunConfig& config, at::Device device);

  // What follows PPO's epochs in an iteration: takes the rollout that they learned from, maybe corrected, and adds to
  // the statistics.
  using AfterEpochs = std::function<absl::Status(const Rollout&, UpdateStats*)>;

  // Takes optimiser steps over `epochs`, each epoch's minibatches of `rollout` in order, from `state` on. If that is
  // not what the last Run returned, Forget must be called before. `should_stop` is asked after each minibatch. Unless
  // OK, `state` is as before. Adams' moments come to `state` with CopyMoments. `after_epochs`: null: nothing.
  //   Cancelled: should_stop() said so.   DataLoss: gradient or weights are not finite, or training diverges
  //   (divergence.h).   ResourceExhausted: the device's memory does not suffice; says what to lower.   Others as
  //   DeviceError (common/agent/device.h), or of `after_epochs`.
  absl::StatusOr<UpdateStats> Run(const Rollout& rollout, const std::vector<std::vector<Minibatch>>& epochs,
                                  const std::function<bool()>& should_stop, const AfterEpochs& after_epochs,
                                  UpdateState* state);

  // Copies the moments after the last Run that was OK to its `state`, if they are not there yet. They are in host
  // memory already, but only a checkpoint needs them.
  void CopyMoments(UpdateState* state);

  // For `after_epochs`: the value normaliser, which is fetched and sent, and a network that trains the weights. Throw
  // c10::Error.
  ValueNorm FetchValueNorm() const;
  void SendValueNorm(const ValueNorm& norm);
  // Used by `after_epochs` alone. This object outlives it.
  std::unique_ptr<DistillationNet> MakeDistillationNet();

  // The next Run sends its `state` to the device again.
  void Forget() {
    is_loaded_ = false;
    has_moments_ = false;
  }

 private:
  // Sends `state` to the device, with the moments of the last Run that was OK.
  void Load(UpdateState* state);
  // `state` gets the moments of the last Run while the device computes.
  absl::StatusOr<UpdateStats> RunEpochs(const Rollout& rollout, const std::vector<std::vector<Minibatch>>& epochs,
                                        const std::function<bool()>& should_stop, const AfterEpochs& after_epochs,
                                        UpdateState* state);
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
  // Copies everything that an update changes to the host: moments to `fetched_`, the rest to `state`, which does not
  // change if that throws.
  void Fetch(UpdateState* state);

  const AgentSpec spec_;
  const v1::PpoConfig config_;
  const uint64_t seed_;
  const bool corrects_lag_;
  const at::Device device_;
  const Network network_;

  bool is_loaded_ = false;  // whether the following is the state after the last Run
  DeviceWeights weights_;
  std::vector<DeviceAdam> adams_;  // PPO's; with distillation also those of matching and prediction
  at::Tensor value_norm_;          // double[2] the normaliser's mean and mean square, not corrected
  double value_weight_ = 0;        // and its weight

  at::Tensor fetched_;        // float[1+2k,n] on the host, aligned: weights, k Adams' moments; undefined before a Run
  bool has_moments_ = false;  // whether they are newer than the state's
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_DEVICE_UPDATE_H_
