// An agent's weights on a device. Includes LibTorch's tensors.

#pragma once

#include <vector>

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include "common/agent/agent_spec.h"
#include "common/agent/nets/param_tensors.h"

namespace craftfleet {

// Its functions throw c10::Error.
struct DeviceWeights {
  at::Tensor flat;      // float[n] in the order of AlignedSpec (common/agent/aligned_weights.h)
  ParamTensors params;  // views of it, which get gradients

  // Sends `weights`, float[spec.param_count].
  void Load(const AgentSpec& spec, const std::vector<float>& weights, at::Device device);

  // Returns to `values`, float[n] on the device, without a gradient.
  void Restore(const at::Tensor& values);

  // Returns and clears the gradient, float[k], aligned likewise, of the parameters that backward passes have reached
  // since the last call: of all, or of all but a goal predictor's, which are last.
  at::Tensor TakeGradient();
};

}  // namespace craftfleet
