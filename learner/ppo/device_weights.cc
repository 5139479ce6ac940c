#include "learner/ppo/device_weights.h"

#include <ATen/ATen.h>

#include "common/agent/policy_net.h"
#include "common/base/check.h"
#include "learner/ppo/device_rollout.h"

namespace craftfleet {

void DeviceWeights::Load(const AgentSpec& spec, const std::vector<float>& weights, at::Device device) {
  flat = SendFloats(weights, device);
  params = ParamsOf(spec, flat);
  for (at::Tensor& weight : params.tensors) weight.set_requires_grad(true);
}

at::Tensor DeviceWeights::TakeGradient() {
  std::vector<at::Tensor> parts;
  for (at::Tensor& param : params.tensors) {
    if (!param.grad().defined()) break;
    parts.push_back(param.grad().flatten());
    param.mutable_grad().reset();
  }
  for (size_t i = parts.size(); i < params.tensors.size(); ++i) CRAFTFLEET_CHECK(!params.tensors[i].grad().defined());
  return at::cat(parts);
}

}  // namespace craftfleet
