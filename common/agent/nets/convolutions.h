// Feature extractors without norms: DQN's convolutions and the size-preserving ones.

#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/agent/nets/layers.h"
#include "common/agent/nets/part.h"

namespace craftfleet {

// Convolutions with a ReLU after each: a map to a map. Source: AGENTS.md, section 2.
class Convolutions : public Part {
 public:
  // Mnih et al. 2015: frames of at least 36 pixels to 64 channels. Names: `name`.0, .2, .4.
  static Convolutions Dqn(const std::string& name, ParamList* params);
  // Four of 5x5 with 64 channels that keep the resolution, `frame_size` pixels a side. Names: `name`.0, .2, .4, .6.
  static Convolutions SizePreserving(const std::string& name, int64_t frame_size, ParamList* params);

  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input,
                     const std::optional<Dropout>& dropout) const override;
  void Prepare(const ParamTensors& params, Preparation* preparation) const override;

  static constexpr int64_t kChannels = 64;  // of the output
  // Pixels, width and height, of DQN's output.
  static int64_t DqnOutputSize(int64_t frame_size) { return ((frame_size - 4) / 4 - 2) / 2 - 2; }

 private:
  Convolutions(std::vector<ConvLayer> layers, int64_t kept_size) : layers_(std::move(layers)), kept_size_(kept_size) {}

  std::vector<ConvLayer> layers_;
  int64_t kept_size_;  // pixels a side of each layer's map; 0: they differ
};

// Flattens a map in the order C,H,W, then a linear layer `name` and a ReLU: features.
class FlattenLinear : public Part {
 public:
  FlattenLinear(const std::string& name, int64_t inputs, int64_t outputs, ParamList* params)
      : linear_(name, inputs, outputs, kHiddenInit, Bias::kZero, params) {}

  at::Tensor Forward(const ParamTensors& params, const at::Tensor& input,
                     const std::optional<Dropout>& dropout) const override;
  void Prepare(const ParamTensors& params, Preparation* preparation) const override {
    linear_.Prepare(params, preparation);
  }

 private:
  LinearLayer linear_;
};

}  // namespace craftfleet
