#include "common/agent/policy_net.h"

#include <ATen/ATen.h>

#include "common/check.h"
#include "common/multiversion.h"

namespace craftfleet {
namespace {

Network MakeNetwork(const v1::NetworkConfig& config) {
  ParamList params;  // known from the spec
  return Network(config, &params);
}

}  // namespace

PolicyNet::PolicyNet(const AgentSpec& spec, Use use, absl::Span<float> weights) : network_(MakeNetwork(spec.network)) {
  for (const ParamSpec& param : spec.params) {
    at::Tensor weight = at::from_blob(weights.data() + param.offset, param.shape);
    if (use == Use::kTraining) {
      weight.set_requires_grad(true);
    } else if (weight.dim() == 4) {
      // oneDNN would otherwise make this layout at every call: 8% of a tile of 8.
      weight = weight.contiguous(at::MemoryFormat::ChannelsLast);
    }
    params_.tensors.push_back(weight);
  }
}

PolicyNet::Output PolicyNet::Forward(const at::Tensor& frames, const Segments& segments,
                                     const absl::optional<Dropout>& dropout) const {
  return network_.Forward(params_, frames, segments, dropout);
}

at::Tensor PolicyNet::Attention(const at::Tensor& frames) const { return network_.Attention(params_, frames); }

std::vector<absl::Span<float>> PolicyNet::gradients() const {
  std::vector<absl::Span<float>> gradients;
  for (const at::Tensor& param : params_.tensors) {
    const at::Tensor& gradient = param.grad();
    CRAFTFLEET_CHECK(gradient.defined() && gradient.is_contiguous());
    gradients.push_back(absl::MakeSpan(gradient.data_ptr<float>(), gradient.numel()));
  }
  return gradients;
}

// Undefined, not zero: a backward pass then hands over its tensors instead of adding to ours.
void PolicyNet::ClearGradients() {
  for (at::Tensor& param : params_.tensors) param.mutable_grad().reset();
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
