#include "learner/ppo/device_weights.h"

#include <algorithm>
#include <cstdint>

#include <ATen/ATen.h>

#include "common/agent/policy_net.h"
#include "common/base/check.h"
#include "learner/ppo/device_rollout.h"

namespace craftfleet {
namespace {

constexpr int64_t kAlignment = 4;  // floats

int64_t AlignedSize(int64_t size) { return (size + kAlignment - 1) / kAlignment * kAlignment; }

// `spec` with the aligned offsets and count.
AgentSpec AlignedSpec(AgentSpec spec) {
  spec.param_count = 0;
  for (ParamSpec& param : spec.params) {
    param.offset = spec.param_count;
    spec.param_count += AlignedSize(param.size);
  }
  return spec;
}

}  // namespace

std::vector<float> Align(const AgentSpec& spec, const std::vector<float>& values) {
  const AgentSpec aligned = AlignedSpec(spec);
  std::vector<float> result(static_cast<size_t>(aligned.param_count), 0.0F);
  for (size_t i = 0; i < spec.params.size(); ++i) {
    std::copy_n(values.data() + spec.params[i].offset, spec.params[i].size, result.data() + aligned.params[i].offset);
  }
  return result;
}

void Unalign(const AgentSpec& spec, const float* aligned, std::vector<float>* values) {
  for (const ParamSpec& param : spec.params) {
    std::copy_n(aligned, param.size, values->data() + param.offset);
    aligned += AlignedSize(param.size);
  }
}

void DeviceWeights::Load(const AgentSpec& spec, const std::vector<float>& weights, at::Device device) {
  flat = SendFloats(Align(spec, weights), device);
  params = ParamsOf(AlignedSpec(spec), flat);
  for (at::Tensor& weight : params.tensors) weight.set_requires_grad(true);
}

at::Tensor DeviceWeights::TakeGradient() {
  std::vector<at::Tensor> parts;
  at::Tensor zeros;
  size_t reached = 0;
  for (at::Tensor& param : params.tensors) {
    if (!param.grad().defined()) break;
    parts.push_back(param.grad().flatten());
    if (const int64_t gap = AlignedSize(param.numel()) - param.numel(); gap > 0) {
      if (!zeros.defined()) zeros = at::zeros({kAlignment}, flat.options());
      parts.push_back(zeros.narrow(0, 0, gap));
    }
    param.mutable_grad().reset();
    ++reached;
  }
  for (size_t i = reached; i < params.tensors.size(); ++i) CRAFTFLEET_CHECK(!params.tensors[i].grad().defined());
  return at::cat(parts);
}

}  // namespace craftfleet
