#include "common/agent/nets/residual_layers.h"

#include <cmath>
#include <optional>

#include <ATen/ATen.h>

namespace craftfleet {
namespace {

constexpr int64_t kHidden = 256;

std::optional<NormLayer> MaybeNorm(bool normed, const std::string& name, int64_t size, ParamList* params) {
  if (!normed) return std::nullopt;
  return NormLayer(name, size, NormLayer::Over::kMap, params);
}

}  // namespace

NormedConv::NormedConv(const std::string& name, int64_t inputs, int64_t outputs, double row_norm, bool normed,
                       ParamList* params)
    : norm_(MaybeNorm(normed, name + ".norm", inputs, params)),
      conv_(name + ".layer", {inputs, outputs, 3, 1, 1}, RowNorm(row_norm), normed ? Bias::kNone : Bias::kZero,
            params) {}

at::Tensor NormedConv::Forward(const ParamTensors& params, const at::Tensor& map) const {
  return conv_.Forward(params, norm_.has_value() ? norm_->Forward(params, map) : map);
}

ResidualBlock::ResidualBlock(const std::string& name, int64_t channels, double row_norm, ParamList* params)
    : first_(name + ".conv0", channels, channels, row_norm, /*normed=*/true, params),
      second_(name + ".conv1", channels, channels, row_norm, /*normed=*/true, params) {}

at::Tensor ResidualBlock::Forward(const ParamTensors& params, const at::Tensor& map) const {
  const at::Tensor hidden = first_.Forward(params, map).relu_().to(at::kFloat);
  return map + second_.Forward(params, hidden).relu_().to(at::kFloat);
}

FeatureLayers::FeatureLayers(const std::string& name, int64_t map_values, int64_t features, ParamList* params)
    : first_(name + ".linear0", map_values, kHidden, 1.4, params),
      second_(name + ".linear1", kHidden, features, 1, params) {}

at::Tensor FeatureLayers::Forward(const ParamTensors& params, const at::Tensor& map) const {
  return second_.Forward(params, first_.Forward(params, map.flatten(1)));
}

double ResidualBlockNorm(int stacks, int blocks) { return std::sqrt(1 / (std::sqrt(stacks) * std::sqrt(blocks))); }

}  // namespace craftfleet
