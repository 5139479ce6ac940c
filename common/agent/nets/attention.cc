#include "common/agent/nets/attention.h"

#include <cmath>
#include <optional>

#include <ATen/ATen.h>
#include <c10/util/accumulate.h>

#include "common/base/keyed_random.h"

namespace craftfleet {
namespace {

constexpr double kCompetitionEpsilon = 1e-8;

// float[...,T,256] -> float[...,heads,T,width].
at::Tensor SplitHeads(const at::Tensor& x, int64_t heads) {
  return x.unflatten(-1, {heads, kAttentionWidth / heads}).transpose(-3, -2);
}

// MixBits of each number of int64[...], whose bits are those of a uint64.
at::Tensor MixBitsOf(const at::Tensor& x) {
  // Shifts in zeros, where LibTorch repeats the sign.
  const auto shifted = [](const at::Tensor& bits, int64_t by) {
    return at::bitwise_and(at::bitwise_right_shift(bits, by), (int64_t{1} << (64 - by)) - 1);
  };
  const auto number = [](uint64_t bits) { return static_cast<int64_t>(bits); };
  const at::Tensor first = at::bitwise_xor(x, shifted(x, 30)) * number(0xBF58476D1CE4E5B9ULL);
  const at::Tensor second = at::bitwise_xor(first, shifted(first, 27)) * number(0x94D049BB133111EBULL);
  return at::bitwise_xor(second, shifted(second, 31));
}

}  // namespace

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

at::Tensor DropoutMaskOnDevice(at::IntArrayRef shape, double probability, int64_t layer, const Dropout& dropout,
                               at::Device device) {
  const auto count = [&](int64_t first, int64_t n) {
    return at::arange(first, first + n, 1, at::TensorOptions(at::kLong).device(device));
  };
  const int64_t rows = shape[0];
  const int64_t row_size = rows == 0 ? 0 : c10::multiply_integers(shape) / rows;
  // KeyedBits, whose last word is the row.
  const uint64_t before_row = KeyedBitsBeforeLast(RandomUse::kDropout, dropout.key, static_cast<uint64_t>(layer));
  const at::Tensor words = (count(dropout.first_row, rows) + 1) * static_cast<int64_t>(kKeyedGamma);
  const at::Tensor row_keys = MixBitsOf(MixBitsOf(words + static_cast<int64_t>(before_row)));
  const at::Tensor bits = MixBitsOf(row_keys.unsqueeze(1) + count(0, row_size));
  // UnitInterval is below the probability.
  const at::Tensor top = at::bitwise_and(at::bitwise_right_shift(bits, 11), (int64_t{1} << 53) - 1);
  const at::Tensor kept = top.ge(static_cast<int64_t>(std::ceil(std::ldexp(probability, 53))));
  return (kept.to(at::kFloat) * static_cast<double>(static_cast<float>(1 / (1 - probability)))).view(shape);
}

at::Tensor CutPatches(const at::Tensor& map, int64_t patch, int64_t stride) {
  if (!map.is_cpu()) {  // there at::im2col is a computation for each row
    return map.unfold(2, patch, stride).unfold(3, patch, stride).permute({0, 2, 3, 1, 4, 5}).flatten(3).flatten(1, 2);
  }
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
                  const AttentionOptions& options, const std::optional<Dropout>& dropout) {
  at::Tensor weights = AttentionWeights(queries, keys, options);
  if (dropout.has_value() && options.drop_probability > 0) {
    weights =
        weights * (weights.is_cpu() ? DropoutMask(weights.sizes(), options.drop_probability, options.layer, *dropout)
                                    : DropoutMaskOnDevice(weights.sizes(), options.drop_probability, options.layer,
                                                          *dropout, weights.device()));
  }
  return at::matmul(weights, SplitHeads(values, options.heads)).transpose(1, 2).flatten(2);
}

}  // namespace craftfleet
