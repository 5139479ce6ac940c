#include "common/agent/nets/grid_resnet.h"

#include <optional>

#include <ATen/ATen.h>
#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

constexpr int64_t kCells = 9;  // of the picture, across and down
constexpr int kBlocks = 2;

}  // namespace

GridResnet::GridResnet(const std::string& name, int64_t frame_size, int64_t width, ParamList* params)
    : cell_(frame_size / kCells),
      border_((frame_size - cell_ * kCells) / 2),
      embed_(name + ".embed", {3, width, cell_, cell_, 0}, RowNorm(1), Bias::kZero, params),
      norm_(name + ".norm", width, NormLayer::Over::kMap, params) {
  const double row_norm = ResidualBlockNorm(1, kBlocks);
  for (int b = 0; b < kBlocks; ++b) blocks_.emplace_back(absl::StrCat(name, ".blocks.", b), width, row_norm, params);
  features_.emplace(name, width * kCells * kCells, kFeatures, params);
}

at::Tensor GridResnet::Forward(const ParamTensors& params, const at::Tensor& input,
                               const std::optional<Dropout>& /*dropout*/) const {
  const int64_t used = cell_ * kCells;
  const at::Tensor cells = input.narrow(2, border_, used).narrow(3, border_, used);
  at::Tensor map = norm_.Forward(params, embed_.Forward(params, cells).relu_().to(at::kFloat));
  for (const ResidualBlock& block : blocks_) map = block.Forward(params, map);
  return features_->Forward(params, map);
}

}  // namespace craftfleet
