// The residual network of Moon et al. 2023. Does not include LibTorch.

#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/agent/nets/layers.h"
#include "common/agent/nets/part.h"
#include "common/agent/nets/residual_layers.h"

namespace craftfleet {

// Frames to 1,024 features: three stacks of w, 2w and 2w channels, each halving width and height, then two linear
// layers. w is `width`, 64 in the paper. Source: AGENTS.md, section 7.
class Resnet : public Part {
 public:
  static constexpr int64_t kFeatures = 1024;

  Resnet(const std::string& name, int64_t frame_size, int64_t width, ParamList* params);

  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input,
                     const std::optional<Dropout>& dropout) const override;

 private:
  struct Stack {
    NormedConv first;
    NormLayer norm;  // after pooling
    std::vector<ResidualBlock> blocks;
  };

  std::vector<Stack> stacks_;
  std::optional<FeatureLayers> features_;
};

}  // namespace craftfleet
