#include "common/agent/nets/resnet.h"

#include <optional>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

constexpr int kStacks = 3;
constexpr int kBlocks = 2;  // of a stack

}  // namespace

Resnet::Resnet(const std::string& name, int64_t frame_size, int64_t width, ParamList* params) {
  int64_t channels = 3;
  int64_t size = frame_size;
  for (int s = 0; s < kStacks; ++s) {
    const int64_t outputs = s == 0 ? width : 2 * width;
    const std::string stack = absl::StrCat(name, ".stacks.", s);
    NormedConv first(stack + ".first", channels, outputs, 1, /*normed=*/s > 0, params);
    const NormLayer norm(stack + ".norm", outputs, NormLayer::Over::kMap, params);
    std::vector<ResidualBlock> blocks;
    blocks.reserve(kBlocks);
    for (int b = 0; b < kBlocks; ++b) {
      blocks.emplace_back(absl::StrCat(stack, ".blocks.", b), outputs, ResidualBlockNorm(kStacks, kBlocks), params);
    }
    stacks_.push_back({first, norm, blocks});
    channels = outputs;
    size = (size + 1) / 2;
  }
  features_.emplace(name, channels * size * size, kFeatures, params);
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
    for (const ResidualBlock& block : stack.blocks) map = block.Forward(params, map);
  }
  return features_->Forward(params, map);
}

}  // namespace craftfleet
