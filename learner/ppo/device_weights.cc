#include "learner/ppo/device_weights.h"

#include <cstdint>

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>

#include "common/agent/aligned_weights.h"
#include "common/agent/policy_net.h"
#include "common/base/check.h"

namespace craftfleet {

void DeviceWeights::Load(const AgentSpec& spec, const std::vector<float>& weights, at::Device device) {
  flat = SendFloats(Align(spec, weights), device);
  params = ParamsOf(AlignedSpec(spec), flat);
  for (at::Tensor& weight : params.tensors) weight.set_requires_grad(true);
}

void DeviceWeights::Restore(const at::Tensor& values) {
  const c10::NoGradGuard no_grad;
  flat.copy_(values);
  for (at::Tensor& param : params.tensors) param.mutable_grad().reset();
}

at::Tensor DeviceWeights::TakeGradient() {
  std::vector<at::Tensor> parts;
  at::Tensor zeros;
  size_t reached = 0;
  for (at::Tensor& param : params.tensors) {
    if (!param.grad().defined()) break;
    parts.push_back(param.grad().flatten());
    if (const int64_t gap = AlignedSize(param.numel()) - param.numel(); gap > 0) {
      if (!zeros.defined()) zeros = at::zeros({AlignedSize(1)}, flat.options());
      parts.push_back(zeros.narrow(0, 0, gap));
    }
    param.mutable_grad().reset();
    ++reached;
  }
  for (size_t i = reached; i < params.tensors.size(); ++i) CRAFTFLEET_CHECK(!params.tensors[i].grad().defined());
  return at::cat(parts);
}

}  // namespace craftfleet
