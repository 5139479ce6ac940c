// A residual network on the cells of Crafter's picture. Does not include LibTorch.

#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/agent/nets/layers.h"
#include "common/agent/nets/part.h"
#include "common/agent/nets/residual_layers.h"

namespace craftfleet {

// Frames to 512 features: one convolution whose kernel and stride are a cell of the picture makes a map of 9x9,
// residual blocks follow, then two linear layers. `width` is the number of the map's channels. Source: AGENTS.md,
// section 7.
class GridResnet : public Part {
 public:
  static constexpr int64_t kFeatures = 512;

  GridResnet(const std::string& name, int64_t frame_size, int64_t width, ParamList* params);

  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input,
                     const std::optional<Dropout>& dropout) const override;

 private:
  int64_t cell_;    // pixels, width and height
  int64_t border_;  // pixels left of the first cell and above it
  ConvLayer embed_;
  NormLayer norm_;
  std::vector<ResidualBlock> blocks_;
  std::optional<FeatureLayers> features_;
};

}  // namespace craftfleet
