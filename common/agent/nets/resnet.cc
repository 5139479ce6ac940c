#include "common/agent/nets/resnet.h"

#include <cmath>
#include <optional>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

constexpr int kStacks = 3;
constexpr int kBlocks = 2;  // of a stack
constexpr int64_t kHidden = 256;

// Of the convolutions in residual blocks: their sum over all stacks and blocks keeps its variance.
double BlockNorm() { return std::sqrt(1 / (std::sqrt(double{kStacks}) * std::sqrt(double{kBlocks}))); }

std::optional<NormLayer> MaybeNorm(bool normed, const std::string& name, int64_t size, ParamList* params) {
  if (!normed) return std::nullopt;
  return NormLayer(name, size, NormLayer::Over::kMap, params);
}

}  // namespace

Resnet::NormedConv::NormedConv(const std::string& name, int64_t inputs, int64_t outputs, double row_norm, bool normed,
                               ParamList* params)
    : norm_(MaybeNorm(normed, name + ".norm", inputs, params)),
      conv_(name + ".layer", {inputs, outputs, 3, 1, 1}, RowNorm(row_norm), normed ? Bias::kNone : Bias::kZero,
            params) {}

at::Tensor Resnet::NormedConv::Forward(const ParamTensors& params, const at::Tensor& map) const {
  return conv_.Forward(params, norm_.has_value() ? norm_->Forward(params, map) : map);
}

at::Tensor Resnet::Block::Forward(const ParamTensors& params, const at::Tensor& map) const {
  const at::Tensor hidden = first.Forward(params, map).relu_().to(at::kFloat);
  return map + second.Forward(params, hidden).relu_().to(at::kFloat);
}

Resnet::Resnet(const std::string& name, int64_t frame_size, int64_t width, ParamList* params) {
  int64_t channels = 3;
  int64_t size = frame_size;
  for (int s = 0; s < kStacks; ++s) {
    const int64_t outputs = s == 0 ? width : 2 * width;
    const std::string stack = absl::StrCat(name, ".stacks.", s);
    NormedConv first(stack + ".first", channels, outputs, 1, /*normed=*/s > 0, params);
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
                           const std::optional<Dropout>& /*dropout*/) const {
  at::Tensor map = input;
  for (const Stack& stack : stacks_) {
    map = stack.first.Forward(params, map).to(at::kFloat);
    // Of the layouts that a GPU has kernels for, only this one's gradient adds in a fixed order.
    if (!map.is_cpu()) map = map.contiguous();
    // The network's ReLU comes before the pooling. Applied after it, values and gradients are the same, and it has a
    // quarter of the work.
    map = at::max_pool2d(map, {3, 3}, {2, 2}, {1, 1}).relu_();
    map = stack.norm.Forward(params, map);
    for (const Block& block : stack.blocks) map = block.Forward(params, map);
  }
  at::Tensor features = map.flatten(1);
  for (const NormedLinear& linear : linears_) features = linear.Forward(params, features);
  return features;
}

}  // namespace craftfleet
