// The losses of distillation (distillation_loss.h) by tensors, on any device. Includes LibTorch's tensors.

#pragma once

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include "common/agent/nets/segments.h"
#include "learner/ppo/distillation/distillation_loss.h"

namespace craftfleet {

// A DistillationStep of n rows and k contrasts on a device.
struct DeviceStep {
  DistillationLoss loss = DistillationLoss::kMatching;
  double temperature = 0.1;
  at::Tensor rows;                               // int64[n]
  at::Tensor before, after, positive, negative;  // int64[k]; after: n for kNoFrame
  at::Tensor weights;                            // double[n]
  at::Tensor targets;                            // double[n]
};

// Does not wait for the device. Throws c10::Error.
DeviceStep SendStep(const DistillationStep& step, at::Device device);

struct DeviceStepLosses {
  at::Tensor by_logits;    // float[n,17] the gradient
  at::Tensor by_values;    // float[n]
  at::Tensor by_features;  // float[n,F] in matching by the features, in prediction by the predictions
  at::Tensor means;        // double[3] the first fields of DistillationLosses in their order
};

// Of the step's `output`. `changes` float[,F] are those that contrasts of matching name, `old_log_probs` double[n,17]
// are of the policy to keep. In double where StepLosses is.
DeviceStepLosses StepLossesOnDevice(const DeviceStep& step, const NetOutput& output, const at::Tensor& changes,
                                    const at::Tensor& old_log_probs);

}  // namespace craftfleet
