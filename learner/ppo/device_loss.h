// PPO's loss with its gradient (ppo_loss.h) by tensors, on any device. Includes LibTorch's tensors.

#pragma once

#include <ATen/core/Tensor.h>

#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/ppo_loss.h"

namespace craftfleet {

// PpoTargets on a device.
struct DeviceTargets {
  at::Tensor actions;     // int64[n]
  at::Tensor log_probs;   // float[n]
  at::Tensor advantages;  // float[n] normalised, times importance weights
  at::Tensor returns;     // float[n]
};

struct DeviceLoss {
  at::Tensor by_logits;  // float[n,17] the gradient
  at::Tensor by_values;  // float[n]
  at::Tensor means;      // double[5] the fields of PpoLossSums in their order, divided by n
};

// int64[n] -> double[n,17]: 1 for each row's action, 0 for the others.
at::Tensor ChosenActions(const at::Tensor& actions);

// Of logits float[n,17] and values float[n], neither with a gradient. In double where PpoLoss is; `config` as there.
DeviceLoss PpoLossOnDevice(const at::Tensor& logits, const at::Tensor& values, const DeviceTargets& targets,
                           const v1::PpoConfig& config);

// Normalise (ppo_loss.h) of float[n].
at::Tensor NormaliseOnDevice(const at::Tensor& advantages);

}  // namespace craftfleet
