#include "common/agent/nets/self_attention.h"

#include <cmath>
#include <optional>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>

#include "common/agent/nets/attention.h"
#include "common/agent/nets/convolutions.h"
#include "common/agent/nets/param_tensors.h"

namespace craftfleet {
namespace {

constexpr int kLayers = 2;

int64_t TokenWidth(int64_t patch) { return Convolutions::kChannels * patch * patch; }

ParamIndex AddCls(const std::string& name, const v1::NetworkConfig& config, ParamList* params) {
  if (!config.cls_learned()) return kNoParam;
  return params->Add(name + ".trafo.cls", {TokenWidth(config.patch())}, {ParamInit::Kind::kNormal, 1});
}

// float[count,256] on `device`: the sines of place / 10000^(2i/256), then the cosines (Vaswani et al. 2017).
at::Tensor Positions(int64_t count, at::Device device) {
  const at::Tensor powers = at::arange(0, kAttentionWidth, 2, device) / static_cast<double>(kAttentionWidth);
  const at::Tensor angles = at::outer(at::arange(count, device), at::exp(powers * -std::log(10000.0)));
  return at::cat({angles.sin(), angles.cos()}, 1);
}

}  // namespace

SelfAttention::SelfAttention(const std::string& name, const v1::NetworkConfig& config, ParamList* params)
    : config_(config),
      cls_(AddCls(name, config, params)),
      embedding_(name + ".trafo.emb_proj", TokenWidth(config.patch()), kAttentionWidth, kHiddenInit, Bias::kZero,
                 params) {
  for (int i = 0; i < kLayers; ++i) {
    layers_.emplace_back(absl::StrCat(name, ".trafo.layers.", i, ".qkv_net"), kAttentionWidth, 3 * kAttentionWidth,
                         kHiddenInit, Bias::kNone, params);
  }
}

at::Tensor SelfAttention::Tokens(const ParamTensors& params, const at::Tensor& input) const {
  const at::Tensor patches = embedding_.ForwardPatches(params, input, config_.patch(), config_.stride(), {});
  const at::Tensor cls = cls_ == kNoParam ? at::zeros({TokenWidth(config_.patch())}, input.options()) : params[cls_];
  const at::Tensor embedded_cls = embedding_.Forward(params, cls.view({1, 1, -1}));
  const at::Tensor tokens = at::cat({embedded_cls.expand({patches.size(0), 1, kAttentionWidth}), patches}, 1);
  return config_.positions() ? tokens + Positions(tokens.size(1), tokens.device()) : tokens;
}

std::vector<at::Tensor> SelfAttention::Project(const ParamTensors& params, int layer, const at::Tensor& tokens) const {
  return layers_[layer].Forward(params, tokens).chunk(3, -1);
}

at::Tensor SelfAttention::Layer(const ParamTensors& params, int layer, const at::Tensor& tokens,
                                const std::optional<Dropout>& dropout) const {
  const std::vector<at::Tensor> qkv = Project(params, layer, tokens);
  return Attend(qkv[0], qkv[1], qkv[2], {config_.heads(), false, config_.dropout(), layer}, dropout);
}

at::Tensor SelfAttention::Forward(const ParamTensors& params, const at::Tensor& input,
                                  const std::optional<Dropout>& dropout) const {
  at::Tensor x = Tokens(params, input);
  for (int i = 0; i < kLayers; ++i) x = Layer(params, i, x, dropout);
  return x.select(1, 0);
}

void SelfAttention::Prepare(const ParamTensors& params, Preparation* preparation) const {
  embedding_.PreparePatches(params, Convolutions::kChannels, config_.frame_size(), config_.patch(), config_.stride(),
                            preparation);
}

at::Tensor SelfAttention::Attention(const ParamTensors& params, const at::Tensor& input) const {
  at::Tensor x = Tokens(params, input);
  for (int i = 0; i < kLayers - 1; ++i) x = Layer(params, i, x, std::nullopt);
  const std::vector<at::Tensor> qkv = Project(params, kLayers - 1, x);
  const at::Tensor of_cls = AttentionWeights(qkv[0].narrow(1, 0, 1), qkv[1], {config_.heads()}).squeeze(2);
  return of_cls.narrow(2, 1, of_cls.size(2) - 1);
}

}  // namespace craftfleet
