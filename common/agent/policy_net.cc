#include "common/agent/policy_net.h"

#include <optional>
#include <utility>

#include <ATen/ATen.h>
#include <c10/core/InferenceMode.h>

#include "common/base/check.h"
#include "common/base/multiversion.h"

namespace craftfleet {
namespace {

constexpr float kScale = 1.0F / 255.0F;  // of a frame's bytes

}  // namespace

Network MakeNetwork(const v1::NetworkConfig& config) {
  ParamList params;  // known from the spec
  return Network(config, &params);
}

ParamTensors ParamsOf(const AgentSpec& spec, const at::Tensor& weights) {
  ParamTensors params;
  if (spec.precision == v1::RunConfig::BF16) params.multiplied_as = at::kBFloat16;
  for (const ParamSpec& param : spec.params) {
    params.tensors.push_back(weights.narrow(0, param.offset, param.size).view(param.shape));
  }
  return params;
}

at::Tensor SendFloats(const std::vector<float>& values, at::Device device) {
  const auto count = static_cast<int64_t>(values.size());
  const at::Tensor host = at::from_blob(const_cast<float*>(values.data()), {count}, at::kFloat);
  return host.to(device, at::kFloat, /*non_blocking=*/false, /*copy=*/true);
}

PolicyNet::PolicyNet(const AgentSpec& spec, Use use, absl::Span<float> weights)
    : params_(ParamsOf(spec, at::from_blob(weights.data(), {static_cast<int64_t>(weights.size())}))),
      network_(MakeNetwork(spec.network)) {
  if (use == Use::kActing) {
    PrepareForActing();
  } else {
    for (at::Tensor& weight : params_.tensors) weight.set_requires_grad(true);
  }
}

PolicyNet::PolicyNet(const AgentSpec& spec, ParamTensors params)
    : params_(std::move(params)), network_(MakeNetwork(spec.network)) {
  PrepareForActing();
}

void PolicyNet::PrepareForActing() {
  for (at::Tensor& weight : params_.tensors) {
    // oneDNN would otherwise make this layout at every call: 8% of a tile of 8.
    if (weight.dim() == 4) weight = weight.contiguous(at::MemoryFormat::ChannelsLast);
  }
  const c10::InferenceMode inference;
  if (params_.multiplied_as != at::kFloat) {
    for (const at::Tensor& weight : params_.tensors) params_.converted.push_back(weight.to(params_.multiplied_as));
  }
  params_.prepared = network_.Prepare(params_, /*for_gradients=*/false, [](const auto& tasks) {
    for (const auto& task : tasks) task();
  });
}

std::shared_ptr<const PreparedWeights> PolicyNet::Prepare(const RunTasks& run) const {
  return network_.Prepare(params_, /*for_gradients=*/true, run);
}

PolicyNet::Output PolicyNet::Forward(const at::Tensor& frames, const Segments& segments,
                                     const std::optional<Dropout>& dropout) const {
  return network_.Forward(params_, frames, segments, dropout);
}

at::Tensor PolicyNet::Codes(const at::Tensor& frames) const { return network_.Features(params_, frames, std::nullopt); }

at::Tensor PolicyNet::Attention(const at::Tensor& frames) const { return network_.Attention(params_, frames); }

std::vector<absl::Span<float>> PolicyNet::gradients() {
  std::vector<absl::Span<float>> gradients;
  for (at::Tensor& param : params_.tensors) {
    at::Tensor& gradient = param.mutable_grad();
    const auto factors = params_.FindWideFactors(static_cast<ParamIndex>(gradients.size()));
    if (factors != nullptr && factors->input.defined()) {
      gradients.emplace_back();
      continue;
    }
    if (!gradient.defined()) break;
    // Convolutions in bfloat16 hand over channels last.
    if (!gradient.is_contiguous()) gradient = gradient.contiguous();
    gradients.push_back(absl::MakeSpan(gradient.data_ptr<float>(), gradient.numel()));
  }
  for (size_t i = gradients.size(); i < params_.tensors.size(); ++i) {
    CRAFTFLEET_CHECK(!params_.tensors[i].grad().defined());
  }
  return gradients;
}

// Undefined, not zero: a backward pass then hands over its tensors instead of adding to ours.
void PolicyNet::ClearGradients() {
  for (at::Tensor& param : params_.tensors) param.mutable_grad().reset();
  for (const auto& [weight, factors] : params_.wide_factors) *factors = WideFactors();
}

void PolicyNet::LeaveWideGradients(bool leaves) {
  params_.wide_factors.clear();
  if (!leaves) return;
  for (size_t i = 0; i < params_.tensors.size(); ++i) {
    if (!WideLinearFits(params_.tensors[i], params_.multiplied_as)) continue;
    params_.wide_factors[static_cast<ParamIndex>(i)] = c10::make_intrusive<WideFactors>();
  }
}

CRAFTFLEET_MULTIVERSION
void ScaleFrames(absl::Span<const uint8_t* const> frames, int64_t frame_bytes, float* out) {
  for (const uint8_t* frame : frames) {
    for (int64_t i = 0; i < frame_bytes; ++i) out[i] = static_cast<float>(int{frame[i]}) * kScale;
    out += frame_bytes;
  }
}

at::Tensor ScaleFrames(const at::Tensor& frames) { return frames.to(at::kFloat).mul_(double{kScale}); }

}  // namespace craftfleet
