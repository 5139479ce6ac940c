// An agent's weights on a device. Includes LibTorch's tensors.

#ifndef CRAFTFLEET_LEARNER_PPO_DEVICE_WEIGHTS_H_
#define CRAFTFLEET_LEARNER_PPO_DEVICE_WEIGHTS_H_

#include <vector>

#include <ATen/core/Tensor.h>
#include <c10/core/Device.h>

#include "common/agent/agent_spec.h"
#include "common/agent/nets/param_tensors.h"

namespace craftfleet {

// Its functions throw c10::Error.
struct DeviceWeights {
  at::Tensor flat;      // float[n] as Align returns them
  ParamTensors params;  // views of it, which get gradients

  // Sends `weights`, float[spec.param_count].
  void Load(const AgentSpec& spec, const std::vector<float>& weights, at::Device device);

  // Returns and clears the gradient, float[k], aligned likewise, of the parameters that backward passes have reached
  // since the last call: of all, or of all but a goal predictor's, which are last.
  at::Tensor TakeGradient();
};

// `values` float[spec.param_count] with each parameter at a multiple of 16 bytes, as the quick kernels of a GPU want
// it, and zeros between.
std::vector<float> Align(const AgentSpec& spec, const std::vector<float>& values);

// The reverse of Align.
void Unalign(const AgentSpec& spec, const float* aligned, std::vector<float>* values);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_DEVICE_WEIGHTS_H_
