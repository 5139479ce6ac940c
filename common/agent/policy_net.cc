#include "common/agent/policy_net.h"

#include <ATen/ATen.h>

#include "common/agent/linear.h"
#include "common/check.h"

namespace craftfleet {
namespace {

at::Tensor View(const ParamSpec& param, absl::Span<float> values) {
  return at::from_blob(values.data() + param.offset, param.shape);
}

std::vector<at::Tensor> TrainedParams(const AgentSpec& spec, absl::Span<float> weights, absl::Span<float> gradients) {
  std::vector<at::Tensor> params;
  for (const ParamSpec& param : spec.params) {
    at::Tensor weight = View(param, weights);
    weight.set_requires_grad(true);
    weight.mutable_grad() = View(param, gradients);
    params.push_back(weight);
  }
  return params;
}

std::vector<at::Tensor> FixedParams(const AgentSpec& spec, absl::Span<float> weights) {
  std::vector<at::Tensor> params;
  for (const ParamSpec& param : spec.params) {
    const at::Tensor weight = View(param, weights);
    // The layout that oneDNN would otherwise make at every call: 8% of a tile of 8.
    params.push_back(weight.dim() == 4 ? weight.contiguous(at::MemoryFormat::ChannelsLast) : weight);
  }
  return params;
}

at::Tensor ConvRelu(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias, int64_t stride) {
  at::Tensor output = at::convolution(input, weight, bias, {stride, stride}, /*padding=*/{0, 0}, /*dilation=*/{1, 1},
                                      /*transposed=*/false, /*output_padding=*/{0, 0}, /*groups=*/1);
  return output.relu_();
}

}  // namespace

PolicyNet::PolicyNet(const AgentSpec& spec, absl::Span<float> weights, absl::Span<float> gradients)
    : PolicyNet(TrainedParams(spec, weights, gradients)) {}

PolicyNet::PolicyNet(const AgentSpec& spec, absl::Span<float> weights) : PolicyNet(FixedParams(spec, weights)) {}

PolicyNet::PolicyNet(const std::vector<at::Tensor>& params) {
  size_t next = 0;
  for (Layer* layer : {&conv1_, &conv2_, &conv3_, &outmap_, &action_net_, &value_net_}) {
    layer->weight = params[next++];
    layer->bias = params[next++];
  }
  CRAFTFLEET_CHECK(next == params.size());
}

PolicyNet::Output PolicyNet::Forward(const at::Tensor& frames) const {
  // Channels last without a copy: oneDNN takes frames as they lie.
  at::Tensor x = frames.permute({0, 3, 1, 2});
  x = ConvRelu(x, conv1_.weight, conv1_.bias, 4);
  x = ConvRelu(x, conv2_.weight, conv2_.bias, 2);
  x = ConvRelu(x, conv3_.weight, conv3_.bias, 1);
  const at::Tensor features = Linear(x.flatten(1), outmap_.weight, outmap_.bias).relu_();
  return {Linear(features, action_net_.weight, action_net_.bias),
          Linear(features, value_net_.weight, value_net_.bias).squeeze(1)};
}

void ScaleFrames(absl::Span<const uint8_t* const> frames, int64_t frame_bytes, float* out) {
  constexpr float kScale = 1.0F / 255.0F;
  for (const uint8_t* frame : frames) {
    for (int64_t i = 0; i < frame_bytes; ++i) out[i] = static_cast<float>(frame[i]) * kScale;
    out += frame_bytes;
  }
}

}  // namespace craftfleet
