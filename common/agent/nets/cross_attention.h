// OC-CA: learned slots attend to patches. Does not include LibTorch.

#pragma once

#include <optional>
#include <string>

#include "common/agent/nets/layers.h"
#include "common/agent/nets/part.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// A map of 64 channels to the mean of the slots, which attend to the tokens: 256 features. Each token gets 13 values
// appended: with p its number mapped evenly to -1..1 and six scales s from 1 to 5 in even steps, sin(p * s * pi),
// cos(p * s * pi) and p. to_q and to_kv have no biases. With `residual_mlp` each slot x becomes x + W2 relu(W1 x), 256
// wide; with `layer_norm` slots, tokens and the input of that MLP are normalised first; with `slot_competition` the
// softmax is over slots (Locatello et al. 2020). Source: Stanic et al. 2022; AGENTS.md, section 5.
class CrossAttention : public AttentionPart {
 public:
  CrossAttention(const std::string& name, const v1::NetworkConfig& config, ParamList* params);

  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input,
                     const std::optional<Dropout>& dropout) const override;
  void Prepare(const ParamTensors& params, Preparation* preparation) const override;
  // Of each slot, mean over its heads.
  at::Tensor Attention(const ParamTensors& params, const at::Tensor& input) const override;

 private:
  // Of the slots, float[slots,256].
  at::Tensor Queries(const ParamTensors& params) const;
  // Of the tokens, float[N,patches,256] each.
  std::vector<at::Tensor> KeysValues(const ParamTensors& params, const at::Tensor& input) const;

  const v1::NetworkConfig config_;
  ParamIndex slots_;                      // `name`.slots [slots,256]
  LinearLayer to_q_;                      // `name`.layer.to_q
  LinearLayer to_kv_;                     // `name`.layer.to_kv: keys, then values
  std::optional<NormLayer> norm_slots_;   // `name`.layer.norm_slots
  std::optional<NormLayer> norm_tokens_;  // `name`.layer.norm_tokens
  std::optional<NormLayer> norm_mlp_;     // `name`.layer.norm_mlp
  std::optional<LinearLayer> mlp_in_;     // `name`.layer.mlp.0
  std::optional<LinearLayer> mlp_out_;    // `name`.layer.mlp.2
};

}  // namespace craftfleet
