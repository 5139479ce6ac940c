// What residual networks are made of, after Moon et al. 2023. Does not include LibTorch.

#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "common/agent/nets/layers.h"

namespace craftfleet {

// Normalises its input and convolves it 3x3: `name`.norm and `name`.layer, whose rows start with the L2 norm
// `row_norm`.
class NormedConv {
 public:
  // `normed`: false for a network's first layer, which has a bias instead.
  NormedConv(const std::string& name, int64_t inputs, int64_t outputs, double row_norm, bool normed, ParamList* params);

  // Before the ReLU, in the type that `params` is multiplied as.
  at::Tensor Forward(const ParamTensors& params, const at::Tensor& map) const;

 private:
  std::optional<NormLayer> norm_;
  ConvLayer conv_;
};

// Two convolutions with a ReLU each, added to the block's input: `name`.conv0 and `name`.conv1.
class ResidualBlock {
 public:
  ResidualBlock(const std::string& name, int64_t channels, double row_norm, ParamList* params);

  at::Tensor Forward(const ParamTensors& params, const at::Tensor& map) const;

 private:
  NormedConv first_;
  NormedConv second_;
};

// A map, flattened, to features: `name`.linear0 to 256 values, then `name`.linear1.
class FeatureLayers {
 public:
  // `map_values`: of a row's map, all channels.
  FeatureLayers(const std::string& name, int64_t map_values, int64_t features, ParamList* params);

  // map float[N,C,H,W] -> float[N,features]
  at::Tensor Forward(const ParamTensors& params, const at::Tensor& map) const;

 private:
  NormedLinear first_;
  NormedLinear second_;
};

// The row norm of all blocks of a network of `stacks` with `blocks` each: their sum keeps its variance.
double ResidualBlockNorm(int stacks, int blocks);

}  // namespace craftfleet
