#include "learner/ppo/adam.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace craftfleet {
namespace {

// Values a part of the work covers: fixed, so that sums don't depend on the number of threads.
constexpr size_t kBlock = 16384;

// Adds `other` to `sum`.
void AddTo(absl::Span<float> sum, absl::Span<const float> other) {
  for (size_t i = 0; i < sum.size(); ++i) sum[i] += other[i];
}

double SumOfSquares(absl::Span<const float> values) {
  // Independent sums, so that the compiler may use vectors.
  std::array<double, 8> sums{};
  size_t i = 0;
  for (; i + sums.size() <= values.size(); i += sums.size()) {
    for (size_t k = 0; k < sums.size(); ++k) sums[k] += static_cast<double>(values[i + k]) * values[i + k];
  }
  double total = 0;
  for (; i < values.size(); ++i) total += static_cast<double>(values[i]) * values[i];
  for (const double sum : sums) total += sum;
  return total;
}

// The numbers of one step, as torch.optim.Adam has them.
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

void Apply(const Step& step, absl::Span<const float> gradient, absl::Span<float> exp_avg, absl::Span<float> exp_avg_sq,
           absl::Span<float> weights) {
  for (size_t i = 0; i < weights.size(); ++i) {
    const float g = gradient[i] * step.gradient_scale;
    exp_avg[i] = exp_avg[i] * step.beta1 + g * step.one_minus_beta1;
    exp_avg_sq[i] = exp_avg_sq[i] * step.beta2 + g * g * step.one_minus_beta2;
    weights[i] -= step.size * exp_avg[i] / (std::sqrt(exp_avg_sq[i]) * step.root_correction + step.epsilon);
  }
}

}  // namespace

double AdamStep(const AdamOptions& options, absl::Span<const absl::Span<float>> gradients, absl::Span<float> weights,
                AdamState* state, WorkerPool* workers) {
  const size_t size = weights.size();
  const int blocks = static_cast<int>((size + kBlock - 1) / kBlock);
  const absl::Span<float> gradient = gradients[0];
  std::vector<double> squares(blocks);
  workers->Run(blocks, [&](int block) {
    const absl::Span<float> sum = gradient.subspan(block * kBlock, kBlock);
    for (size_t shard = 1; shard < gradients.size(); ++shard) {
      AddTo(sum, gradients[shard].subspan(block * kBlock, kBlock));
    }
    squares[block] = SumOfSquares(sum);
  });
  double total = 0;
  for (const double square : squares) total += square;
  const double norm = std::sqrt(total);
  if (!std::isfinite(norm)) return norm;

  const double t = static_cast<double>(++state->steps);
  const Step step = {static_cast<float>(std::min(1.0, options.max_gradient_norm / (norm + 1e-6))),
                     static_cast<float>(options.beta1),
                     static_cast<float>(1 - options.beta1),
                     static_cast<float>(options.beta2),
                     static_cast<float>(1 - options.beta2),
                     static_cast<float>(options.learning_rate / (1 - std::pow(options.beta1, t))),
                     static_cast<float>(1 / std::sqrt(1 - std::pow(options.beta2, t))),
                     static_cast<float>(options.epsilon)};
  workers->Run(blocks, [&](int block) {
    const size_t first = block * kBlock;
    Apply(step, gradient.subspan(first, kBlock), absl::MakeSpan(state->exp_avg).subspan(first, kBlock),
          absl::MakeSpan(state->exp_avg_sq).subspan(first, kBlock), weights.subspan(first, kBlock));
  });
  return norm;
}

}  // namespace craftfleet
