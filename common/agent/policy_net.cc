#include "common/agent/policy_net.h"

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>

#include "common/check.h"
#include "common/multiversion.h"

namespace craftfleet {
namespace {

Network MakeNetwork(const v1::NetworkConfig& config) {
  ParamList params;  // known from the spec
  return Network(config, &params);
}

}  // namespace

PolicyNet::PolicyNet(const AgentSpec& spec, Use use, absl::Span<float> weights, at::Device device)
    : device_(device),
      network_(MakeNetwork(spec.network)),
      host_weights_(at::from_blob(weights.data(), {static_cast<int64_t>(weights.size())})),
      device_weights_(host_weights_.to(device)) {
  CRAFTFLEET_CHECK(!elsewhere() || use == Use::kTraining);
  for (const ParamSpec& param : spec.params) {
    at::Tensor weight = device_weights_.narrow(0, param.offset, param.size).view(param.shape);
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
  return elsewhere() ? ForwardElsewhere(frames, segments, dropout)
                     : network_.Forward(params_, frames, segments, dropout);
}

PolicyNet::Output PolicyNet::ForwardElsewhere(const at::Tensor& frames, const Segments& segments,
                                              const absl::optional<Dropout>& dropout) const {
  {
    const c10::NoGradGuard no_grad;
    device_weights_.copy_(host_weights_);
  }
  Segments there = segments;
  if (there.states.defined()) there.states = there.states.to(device_);
  const Output output = network_.Forward(params_, frames.to(device_), there, dropout);
  return {output.logits.cpu(), output.values.cpu(), output.states.defined() ? output.states.cpu() : at::Tensor()};
}

at::Tensor PolicyNet::Attention(const at::Tensor& frames) const { return network_.Attention(params_, frames); }

std::vector<absl::Span<float>> PolicyNet::gradients() {
  std::vector<at::Tensor> tensors;
  for (const at::Tensor& param : params_.tensors) {
    CRAFTFLEET_CHECK(param.grad().defined());
    tensors.push_back(param.grad());
  }
  if (elsewhere()) {
    std::vector<int64_t> sizes;
    for (at::Tensor& gradient : tensors) {
      sizes.push_back(gradient.numel());
      gradient = gradient.flatten();
    }
    host_gradients_ = at::cat(tensors).cpu();  // in one piece: dozens of small copies wait for each other
    tensors = host_gradients_.split_with_sizes(sizes);
  }
  std::vector<absl::Span<float>> gradients;
  for (const at::Tensor& gradient : tensors) {
    CRAFTFLEET_CHECK(gradient.is_contiguous());
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
