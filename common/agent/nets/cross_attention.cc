#include "common/agent/nets/cross_attention.h"

#include <optional>
#include <vector>

#include <ATen/ATen.h>

#include "common/agent/attention_map.h"
#include "common/agent/nets/attention.h"
#include "common/agent/nets/convolutions.h"
#include "common/agent/nets/param_tensors.h"

namespace craftfleet {
namespace {

constexpr double kPi = 3.141592653589793;
constexpr int64_t kScales = 6;
constexpr int64_t kPositionWidth = 2 * kScales + 1;

int64_t TokenWidth(int64_t patch) { return Convolutions::kChannels * patch * patch + kPositionWidth; }

// float[count,13] on `device` of p from -1 to 1 over the tokens in order: sin(p s pi) and cos(p s pi) for six scales s
// from 1 to 5, then p.
at::Tensor Positions(int64_t count, at::Device device) {
  const at::Tensor places = at::linspace(-1, 1, count, device).unsqueeze(1);
  const at::Tensor angles = places * at::linspace(1, 5, kScales, device) * kPi;
  return at::cat({angles.sin(), angles.cos(), places}, 1);
}

at::Tensor Normed(const std::optional<NormLayer>& norm, const ParamTensors& params, const at::Tensor& x) {
  return norm.has_value() ? norm->Forward(params, x) : x;
}

}  // namespace

CrossAttention::CrossAttention(const std::string& name, const v1::NetworkConfig& config, ParamList* params)
    : config_(config),
      slots_(params->Add(name + ".slots", {config.slots(), kAttentionWidth}, {ParamInit::Kind::kNormal, 1})),
      to_q_(name + ".layer.to_q", kAttentionWidth, kAttentionWidth, kHiddenInit, Bias::kNone, params),
      to_kv_(name + ".layer.to_kv", TokenWidth(config.patch()), 2 * kAttentionWidth, kHiddenInit, Bias::kNone, params) {
  if (config.layer_norm()) {
    norm_slots_.emplace(name + ".layer.norm_slots", kAttentionWidth, NormLayer::Over::kFeatures, params);
    norm_tokens_.emplace(name + ".layer.norm_tokens", TokenWidth(config.patch()), NormLayer::Over::kFeatures, params);
  }
  if (!config.residual_mlp()) return;
  if (config.layer_norm()) {
    norm_mlp_.emplace(name + ".layer.norm_mlp", kAttentionWidth, NormLayer::Over::kFeatures, params);
  }
  mlp_in_.emplace(name + ".layer.mlp.0", kAttentionWidth, kAttentionWidth, kHiddenInit, Bias::kZero, params);
  mlp_out_.emplace(name + ".layer.mlp.2", kAttentionWidth, kAttentionWidth, kHiddenInit, Bias::kZero, params);
}

at::Tensor CrossAttention::Queries(const ParamTensors& params) const {
  return to_q_.Forward(params, Normed(norm_slots_, params, params[slots_]));
}

std::vector<at::Tensor> CrossAttention::KeysValues(const ParamTensors& params, const at::Tensor& input) const {
  const PatchGrid grid = {static_cast<int>(input.size(2)), config_.patch(), config_.stride()};
  const at::Tensor positions = Positions(grid.count(), input.device());
  if (!norm_tokens_.has_value()) {
    return to_kv_.ForwardPatches(params, input, config_.patch(), config_.stride(), positions).chunk(2, -1);
  }
  const at::Tensor patches = CutPatches(input, config_.patch(), config_.stride());
  const at::Tensor tokens = at::cat({patches, positions.expand({patches.size(0), patches.size(1), kPositionWidth})}, 2);
  return to_kv_.Forward(params, norm_tokens_->Forward(params, tokens)).chunk(2, -1);
}

void CrossAttention::Prepare(const ParamTensors& params, Preparation* preparation) const {
  if (norm_tokens_.has_value()) return;
  to_kv_.PreparePatches(params, Convolutions::kChannels, config_.frame_size(), config_.patch(), config_.stride(),
                        preparation);
}

at::Tensor CrossAttention::Forward(const ParamTensors& params, const at::Tensor& input,
                                   const std::optional<Dropout>& dropout) const {
  const std::vector<at::Tensor> keys_values = KeysValues(params, input);
  at::Tensor x = Attend(Queries(params), keys_values[0], keys_values[1],
                        {config_.heads(), config_.slot_competition(), config_.dropout(), 0}, dropout);
  if (mlp_in_.has_value()) {
    x = x + mlp_out_->Forward(params, mlp_in_->Forward(params, Normed(norm_mlp_, params, x)).relu_());
  }
  return x.mean(1);
}

at::Tensor CrossAttention::Attention(const ParamTensors& params, const at::Tensor& input) const {
  return AttentionWeights(Queries(params), KeysValues(params, input)[0], {config_.heads(), config_.slot_competition()})
      .mean(1);
}

}  // namespace craftfleet
