#include "common/agent/nets/self_attention.h"

#include <cmath>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>

#include "common/agent/nets/attention.h"
#include "common/agent/nets/convolutions.h"
#include "common/agent/nets/param_tensors.h"

namespace craftfleet {
namespace {

constexpr int kLayers = 2;

int64_t TokenWidth(int64_t patch) { return Convolutions::kChannels * patch * patch; }

ParamIndex AddCls(const std::string& name, const SelfAttention::Options& options, ParamList* params) {
  if (!options.cls_learned) return kNoParam;
  return params->Add(name + ".trafo.cls", {TokenWidth(options.patch)}, {ParamInit::Kind::kNormal, 1});
}

// float[count,256]: the sines of place / 10000^(2i/256), then the cosines (Vaswani et al. 2017).
at::Tensor Positions(int64_t count) {
  const at::Tensor powers = at::arange(0, kAttentionWidth, 2) / static_cast<double>(kAttentionWidth);
  const at::Tensor angles = at::outer(at::arange(count), at::exp(powers * -std::log(10000.0)));
  return at::cat({angles.sin(), angles.cos()}, 1);
}

}  // namespace

SelfAttention::SelfAttention(const std::string& name, const Options& options, ParamList* params)
    : options_(options),
      cls_(AddCls(name, options, params)),
      embedding_(name + ".trafo.emb_proj", TokenWidth(options.patch), kAttentionWidth, kHiddenInit, Bias::kZero,
                 params) {
  for (int i = 0; i < kLayers; ++i) {
    layers_.emplace_back(absl::StrCat(name, ".trafo.layers.", i, ".qkv_net"), kAttentionWidth, 3 * kAttentionWidth,
                         kHiddenInit, Bias::kNone, params);
  }
}

at::Tensor SelfAttention::Forward(const ParamTensors& params, const at::Tensor& input,
                                  const absl::optional<Dropout>& dropout) const {
  const at::Tensor patches = embedding_.Forward(params, CutPatches(input, options_.patch, options_.stride));
  const at::Tensor cls = cls_ == kNoParam ? at::zeros({TokenWidth(options_.patch)}) : params[cls_];
  const at::Tensor embedded_cls = embedding_.Forward(params, cls.view({1, 1, -1}));
  at::Tensor x = at::cat({embedded_cls.expand({patches.size(0), 1, kAttentionWidth}), patches}, 1);
  if (options_.positions) x = x + Positions(x.size(1));
  for (int i = 0; i < kLayers; ++i) {
    const std::vector<at::Tensor> qkv = layers_[i].Forward(params, x).chunk(3, -1);
    x = Attend(qkv[0], qkv[1], qkv[2], {options_.heads, false, options_.dropout, i}, dropout);
  }
  return x.select(1, 0);
}

}  // namespace craftfleet
