// OC-SA: patches and a CLS token attend to each other. Does not include LibTorch.

#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/agent/nets/layers.h"
#include "common/agent/nets/part.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// A map of 64 channels to the CLS row of the second layer: 256 features. A CLS token is put in front of the patches;
// emb_proj, with bias, makes each token 256 wide. With `positions`, token number t (0 is CLS) gets sin(t * w_i) added
// in its first 128 values and cos(t * w_i) in the last 128, w_i = 10000^(-2i / 256). Two layers of attention follow. No
// residual connection, norm, feed-forward layer or output projection. Source: Stanic et al. 2022; AGENTS.md, section 4.
class SelfAttention : public AttentionPart {
 public:
  SelfAttention(const std::string& name, const v1::NetworkConfig& config, ParamList* params);

  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input,
                     const std::optional<Dropout>& dropout) const override;
  void Prepare(const ParamTensors& params, Preparation* preparation) const override;
  // Of each head in the last layer. The CLS token's attention to itself is left out, so that a head's sum is below 1.
  at::Tensor Attention(const ParamTensors& params, const at::Tensor& input) const override;

 private:
  // float[N,1+patches,256]: the embedded CLS token and patches.
  at::Tensor Tokens(const ParamTensors& params, const at::Tensor& input) const;
  // Tokens -> queries, keys and values of `layer`.
  std::vector<at::Tensor> Project(const ParamTensors& params, int layer, const at::Tensor& tokens) const;
  at::Tensor Layer(const ParamTensors& params, int layer, const at::Tensor& tokens,
                   const std::optional<Dropout>& dropout) const;

  const v1::NetworkConfig config_;
  ParamIndex cls_ = kNoParam;        // `name`.trafo.cls [token width]
  LinearLayer embedding_;            // `name`.trafo.emb_proj
  std::vector<LinearLayer> layers_;  // `name`.trafo.layers.<i>.qkv_net: queries, keys, values
};

}  // namespace craftfleet
