#include "common/agent/nets/resnet.h"

#include <cmath>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

constexpr int64_t kStackChannels[] = {64, 128, 128};
constexpr int kStacks = 3;
constexpr int kBlocks = 2;  // of a stack
constexpr int64_t kHidden = 256;

ParamInit RowNorm(double norm) { return {ParamInit::Kind::kRowNorm, norm}; }

// Of the convolutions in residual blocks: their sum over all stacks and blocks keeps its variance.
double BlockNorm() { return std::sqrt(1 / (std::sqrt(double{kStacks}) * std::sqrt(double{kBlocks}))); }

absl::optional<NormLayer> MaybeNorm(bool normed, const std::string& name, int64_t size, ParamList* params) {
  if (!normed) return absl::nullopt;
  return NormLayer(name, size, NormLayer::Over::kMap, params);
}

}  // namespace

Resnet::NormedConv::NormedConv(const std::string& name, int64_t inputs, int64_t outputs, double row_norm, bool normed,
                               ParamList* params)
    : norm_(MaybeNorm(normed, name + ".norm", inputs, params)),
      conv_(name + ".layer", {inputs, outputs, 3, 1, 1}, RowNorm(row_norm), normed ? Bias::kNone : Bias::kZero,
            params) {}

at::Tensor Resnet::NormedConv::Forward(const ParamTensors& params, const at::Tensor& map) const {
  return conv_.Forward(params, norm_.has_value() ? norm_->Forward(params, map) : map).relu_();
}

Resnet::NormedLinear::NormedLinear(const std::string& name, int64_t inputs, int64_t outputs, double row_norm,
                                   ParamList* params)
    : norm_(name + ".norm", inputs, NormLayer::Over::kFeatures, params),
      linear_(name + ".layer", inputs, outputs, RowNorm(row_norm), Bias::kNone, params) {}

at::Tensor Resnet::NormedLinear::Forward(const ParamTensors& params, const at::Tensor& features) const {
  return linear_.Forward(params, norm_.Forward(params, features)).relu_();
}

Resnet::Resnet(const std::string& name, int64_t frame_size, ParamList* params) {
  int64_t channels = 3;
  int64_t size = frame_size;
  for (const int64_t outputs : kStackChannels) {
    const std::string stack = absl::StrCat(name, ".stacks.", stacks_.size());
    const bool is_first = stacks_.empty();
    NormedConv first(stack + ".first", channels, outputs, 1, /*normed=*/!is_first, params);
    const NormLayer norm(stack + ".norm", outputs, NormLayer::Over::kMap, params);
    std::vector<Block> blocks;
    for (int i = 0; i < kBlocks; ++i) {
      const std::string block = absl::StrCat(stack, ".blocks.", i);
      const NormedConv conv0(block + ".conv0", outputs, outputs, BlockNorm(), /*normed=*/true, params);
      const NormedConv conv1(block + ".conv1", outputs, outputs, BlockNorm(), /*normed=*/true, params);
      blocks.push_back({conv0, conv1});
    }
    stacks_.push_back({first, norm, blocks});
    channels = outputs;
    size = (size + 1) / 2;
  }
  linears_.emplace_back(name + ".linear0", channels * size * size, kHidden, 1.4, params);
  linears_.emplace_back(name + ".linear1", kHidden, kFeatures, 1, params);
}

at::Tensor Resnet::Forward(const ParamTensors& params, const at::Tensor& input,
                           const absl::optional<Dropout>& /*dropout*/) const {
  at::Tensor map = input;
  for (const Stack& stack : stacks_) {
    map = at::max_pool2d(stack.first.Forward(params, map), {3, 3}, {2, 2}, {1, 1});
    map = stack.norm.Forward(params, map);
    for (const Block& block : stack.blocks) {
      map = map + block.second.Forward(params, block.first.Forward(params, map));
    }
  }
  at::Tensor features = map.flatten(1);
  for (const NormedLinear& linear : linears_) features = linear.Forward(params, features);
  return features;
}

}  // namespace craftfleet
