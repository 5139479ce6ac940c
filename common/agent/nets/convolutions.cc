#include "common/agent/nets/convolutions.h"

#include <optional>
#include <utility>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

std::vector<ConvLayer> MakeLayers(const std::string& name, const std::vector<ConvLayer::Shape>& shapes,
                                  ParamList* params) {
  std::vector<ConvLayer> layers;
  for (size_t i = 0; i < shapes.size(); ++i) {
    // Every second number belongs to a ReLU.
    layers.emplace_back(absl::StrCat(name, ".", 2 * i), shapes[i], kHiddenInit, Bias::kZero, params);
  }
  return layers;
}

}  // namespace

Convolutions Convolutions::Dqn(const std::string& name, ParamList* params) {
  return Convolutions(MakeLayers(name, {{3, 32, 8, 4, 0}, {32, 64, 4, 2, 0}, {64, kChannels, 3, 1, 0}}, params),
                      /*kept_size=*/0);
}

Convolutions Convolutions::SizePreserving(const std::string& name, int64_t frame_size, ParamList* params) {
  return Convolutions(
      MakeLayers(name, {{3, 64, 5, 1, 2}, {64, 64, 5, 1, 2}, {64, 64, 5, 1, 2}, {64, kChannels, 5, 1, 2}}, params),
      frame_size);
}

at::Tensor Convolutions::Forward(const ParamTensors& params, const at::Tensor& input,
                                 const std::optional<Dropout>& /*dropout*/) const {
  at::Tensor map = input;
  for (const ConvLayer& layer : layers_) {
    map = kept_size_ > 0 ? layer.ForwardRelu(params, map) : layer.Forward(params, map).relu_();
  }
  return map.to(at::kFloat);
}

void Convolutions::Prepare(const ParamTensors& params, Preparation* preparation) const {
  if (kept_size_ == 0) return;
  for (const ConvLayer& layer : layers_) layer.Prepare(params, kept_size_, preparation);
}

at::Tensor FlattenLinear::Forward(const ParamTensors& params, const at::Tensor& input,
                                  const std::optional<Dropout>& /*dropout*/) const {
  return linear_.Forward(params, input.flatten(1)).relu_();
}

}  // namespace craftfleet
