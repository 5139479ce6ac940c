#include "common/agent/policy_net.h"

#include <ATen/ATen.h>

#include "common/agent/linear.h"
#include "common/check.h"
#include "common/multiversion.h"

namespace craftfleet {
namespace {

at::Tensor ConvRelu(const at::Tensor& input, const at::Tensor& weight, const at::Tensor& bias, int64_t stride) {
  at::Tensor output = at::convolution(input, weight, bias, {stride, stride}, /*padding=*/{0, 0}, /*dilation=*/{1, 1},
                                      /*transposed=*/false, /*output_padding=*/{0, 0}, /*groups=*/1);
  return output.relu_();
}

}  // namespace

PolicyNet::PolicyNet(const AgentSpec& spec, Use use, absl::Span<float> weights) {
  for (const ParamSpec& param : spec.params) {
    at::Tensor weight = at::from_blob(weights.data() + param.offset, param.shape);
    if (use == Use::kTraining) {
      weight.set_requires_grad(true);
    } else if (weight.dim() == 4) {
      // oneDNN would otherwise make this layout at every call: 8% of a tile of 8.
      weight = weight.contiguous(at::MemoryFormat::ChannelsLast);
    }
    params_.push_back(weight);
  }
  size_t next = 0;
  for (Layer* layer : {&conv1_, &conv2_, &conv3_, &outmap_, &action_net_, &value_net_}) {
    layer->weight = params_[next++];
    layer->bias = params_[next++];
  }
  CRAFTFLEET_CHECK(next == params_.size());
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

std::vector<absl::Span<float>> PolicyNet::gradients() const {
  std::vector<absl::Span<float>> gradients;
  for (const at::Tensor& param : params_) {
    const at::Tensor& gradient = param.grad();
    CRAFTFLEET_CHECK(gradient.defined() && gradient.is_contiguous());
    gradients.push_back(absl::MakeSpan(gradient.data_ptr<float>(), gradient.numel()));
  }
  return gradients;
}

// Undefined, not zero: a backward pass then hands over its tensors instead of adding to ours.
void PolicyNet::ClearGradients() {
  for (at::Tensor& param : params_) param.mutable_grad().reset();
}

CRAFTFLEET_MULTIVERSION
void ScaleFrames(absl::Span<const uint8_t* const> frames, int64_t frame_bytes, float* out) {
  constexpr float kScale = 1.0F / 255.0F;
  for (const uint8_t* frame : frames) {
    for (int64_t i = 0; i < frame_bytes; ++i) out[i] = static_cast<float>(int{frame[i]}) * kScale;
    out += frame_bytes;
  }
}

}  // namespace craftfleet
