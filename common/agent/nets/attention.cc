#include "common/agent/nets/attention.h"

#include <cmath>

#include <ATen/ATen.h>

#include "common/keyed_random.h"

namespace craftfleet {
namespace {

constexpr double kCompetitionEpsilon = 1e-8;

// float[...,T,256] -> float[...,heads,T,width].
at::Tensor SplitHeads(const at::Tensor& x, int64_t heads) {
  return x.unflatten(-1, {heads, kAttentionWidth / heads}).transpose(-3, -2);
}

// float[N,...]: 0 with `probability`, else 1 / (1 - probability).
at::Tensor DropoutMask(at::IntArrayRef shape, double probability, int64_t layer, const Dropout& dropout) {
  at::Tensor mask = at::empty(shape);
  const float kept = static_cast<float>(1 / (1 - probability));
  const int64_t row_size = mask.numel() / mask.size(0);
  float* out = mask.data_ptr<float>();
  for (int64_t row = 0; row < mask.size(0); ++row) {
    const uint64_t row_key = KeyedBits(RandomUse::kDropout, dropout.key, static_cast<uint64_t>(layer),
                                       static_cast<uint64_t>(dropout.first_row + row));
    for (int64_t i = 0; i < row_size; ++i) {
      *out++ = UnitInterval(MixBits(row_key + static_cast<uint64_t>(i))) < probability ? 0.0F : kept;
    }
  }
  return mask;
}

}  // namespace

at::Tensor CutPatches(const at::Tensor& map, int64_t patch, int64_t stride) {
  return at::im2col(map, {patch, patch}, /*dilation=*/{1, 1}, /*padding=*/{0, 0}, {stride, stride}).transpose(1, 2);
}

at::Tensor AttentionWeights(const at::Tensor& queries, const at::Tensor& keys, const AttentionOptions& options) {
  const int64_t head_width = kAttentionWidth / options.heads;
  const double scale = 1 / std::sqrt(static_cast<double>(head_width));
  const at::Tensor scores = at::matmul(SplitHeads(queries, options.heads) * scale,
                                       SplitHeads(keys, options.heads).transpose(-2, -1));  // [N,heads,Q,T]
  if (!options.competition) return scores.softmax(-1);
  const at::Tensor shares = scores.softmax(-2) + kCompetitionEpsilon;
  return shares / shares.sum(-1, /*keepdim=*/true);
}

at::Tensor Attend(const at::Tensor& queries, const at::Tensor& keys, const at::Tensor& values,
                  const AttentionOptions& options, const absl::optional<Dropout>& dropout) {
  at::Tensor weights = AttentionWeights(queries, keys, options);
  if (dropout.has_value() && options.drop_probability > 0) {
    weights =
        weights * DropoutMask(weights.sizes(), options.drop_probability, options.layer, *dropout).to(weights.device());
  }
  return at::matmul(weights, SplitHeads(values, options.heads)).transpose(1, 2).flatten(2);
}

}  // namespace craftfleet
