#include "learner/ppo/adam.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "common/base/multiversion.h"

namespace craftfleet {
namespace {

// A part of the work: a stretch of one piece of the gradient.
struct Block {
  size_t piece;
  size_t offset;          // in the piece
  size_t weights_offset;  // in the flat array
};

std::vector<Block> CutIntoBlocks(const ShardGradient& gradient) {
  std::vector<Block> blocks;
  size_t piece_start = 0;
  for (size_t piece = 0; piece < gradient.size(); ++piece) {
    for (size_t offset = 0; offset < gradient[piece].size(); offset += kAdamBlock) {
      blocks.push_back({piece, offset, piece_start + offset});
    }
    piece_start += gradient[piece].size();
  }
  return blocks;
}

// The loops below work on bare pointers: through spans the compiler does not see that nothing overlaps.

CRAFTFLEET_MULTIVERSION
void AddTo(float* __restrict sum, const float* __restrict other, size_t size) {
  for (size_t i = 0; i < size; ++i) sum[i] += other[i];
}

CRAFTFLEET_MULTIVERSION
double SumOfSquares(const float* values, size_t size) {
  // Independent sums, so that the compiler may use vectors.
  std::array<double, 8> sums{};
  size_t i = 0;
  for (; i + sums.size() <= size; i += sums.size()) {
    for (size_t k = 0; k < sums.size(); ++k) sums[k] += static_cast<double>(values[i + k]) * values[i + k];
  }
  double total = 0;
  for (; i < size; ++i) total += static_cast<double>(values[i]) * values[i];
  for (const double sum : sums) total += sum;
  return total;
}

// The constants of one step, as torch.optim.Adam computes them.
struct Step {
  float gradient_scale;
  float beta1;
  float one_minus_beta1;
  float beta2;
  float one_minus_beta2;
  float size;             // learning rate / (1 - beta1^t)
  float root_correction;  // 1 / sqrt(1 - beta2^t)
  float epsilon;
};

CRAFTFLEET_MULTIVERSION
void Apply(Step step, size_t size, const float* __restrict gradient, float* __restrict exp_avg,
           float* __restrict exp_avg_sq, float* __restrict weights) {
  for (size_t i = 0; i < size; ++i) {
    const float g = gradient[i] * step.gradient_scale;
    exp_avg[i] = exp_avg[i] * step.beta1 + g * step.one_minus_beta1;
    exp_avg_sq[i] = exp_avg_sq[i] * step.beta2 + g * g * step.one_minus_beta2;
    weights[i] -= step.size * exp_avg[i] / (std::sqrt(exp_avg_sq[i]) * step.root_correction + step.epsilon);
  }
}

}  // namespace

double AdamStep(const v1::PpoConfig& config, absl::Span<const ShardGradient> shards, absl::Span<float> weights,
                AdamState* state, WorkerPool* workers) {
  const std::vector<Block> blocks = CutIntoBlocks(shards[0]);
  const int count = static_cast<int>(blocks.size());
  const auto part_of = [&](const ShardGradient& shard, int i) {
    return shard[blocks[i].piece].subspan(blocks[i].offset, kAdamBlock);
  };
  std::vector<double> squares(count);
  workers->Run(count, [&](int i) {
    const absl::Span<float> sum = part_of(shards[0], i);
    for (const ShardGradient& other : shards.subspan(1)) {
      if (!other[blocks[i].piece].empty()) AddTo(sum.data(), part_of(other, i).data(), sum.size());
    }
    squares[i] = SumOfSquares(sum.data(), sum.size());
  });
  double total = 0;
  for (const double square : squares) total += square;
  const double norm = std::sqrt(total);
  if (!std::isfinite(norm)) return norm;

  const double t = static_cast<double>(++state->steps);
  const Step step = {static_cast<float>(std::min(1.0, config.max_gradient_norm() / (norm + 1e-6))),
                     static_cast<float>(kAdamBeta1),
                     static_cast<float>(1 - kAdamBeta1),
                     static_cast<float>(kAdamBeta2),
                     static_cast<float>(1 - kAdamBeta2),
                     static_cast<float>(config.learning_rate() / (1 - std::pow(kAdamBeta1, t))),
                     static_cast<float>(1 / std::sqrt(1 - std::pow(kAdamBeta2, t))),
                     static_cast<float>(config.adam_epsilon())};
  workers->Run(count, [&](int i) {
    const absl::Span<const float> gradient = part_of(shards[0], i);
    const size_t offset = blocks[i].weights_offset;
    Apply(step, gradient.size(), gradient.data(), state->exp_avg.data() + offset, state->exp_avg_sq.data() + offset,
          weights.data() + offset);
  });
  return norm;
}

}  // namespace craftfleet
