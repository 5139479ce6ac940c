#include "learner/ppo/distillation/distillation_loss.h"

#include <cmath>
#include <cstddef>
#include <vector>

#include "common/agent/categorical.h"
#include "common/base/crafter.h"

namespace craftfleet {
namespace {

// A vector scaled to length 1, or zero.
struct Unit {
  explicit Unit(const float* vector, int size) : values(size) {
    double squares = 0;
    for (int i = 0; i < size; ++i) squares += double{vector[i]} * vector[i];
    length = std::sqrt(squares);
    for (int i = 0; i < size && length > 0; ++i) values[i] = vector[i] / length;
  }

  double Dot(const Unit& other) const {
    double sum = 0;
    for (size_t i = 0; i < values.size(); ++i) sum += values[i] * other.values[i];
    return sum;
  }

  // Adds the gradient by the vector, given that by its scaled values, factor * direction.
  void AddGradient(double factor, const std::vector<double>& direction, float* gradient) const {
    if (gradient == nullptr || length == 0) return;
    double along = 0;
    for (size_t i = 0; i < values.size(); ++i) along += values[i] * direction[i];
    for (size_t i = 0; i < values.size(); ++i) {
      gradient[i] += static_cast<float>(factor * (direction[i] - along * values[i]) / length);
    }
  }

  std::vector<double> values;
  double length = 0;
};

double Softplus(double x) { return x > 0 ? x + std::log1p(std::exp(-x)) : std::log1p(std::exp(x)); }

double Sigmoid(double x) { return x > 0 ? 1 / (1 + std::exp(-x)) : std::exp(x) / (1 + std::exp(x)); }

}  // namespace

double ContrastiveLoss(absl::Span<const ContrastiveRow> rows, int size, double temperature) {
  double sum = 0;
  for (const ContrastiveRow& row : rows) {
    const Unit anchor(row.anchor, size);
    const Unit positive(row.positive, size);
    const Unit negative(row.negative, size);
    const double excess = (anchor.Dot(negative) - anchor.Dot(positive)) / temperature;
    sum += Softplus(excess);
    const double factor = Sigmoid(excess) / temperature / static_cast<double>(rows.size());
    std::vector<double> difference(size);
    for (int i = 0; i < size; ++i) difference[i] = negative.values[i] - positive.values[i];
    anchor.AddGradient(factor, difference, row.by_anchor);
    positive.AddGradient(-factor, anchor.values, row.by_positive);
    negative.AddGradient(factor, anchor.values, row.by_negative);
  }
  return sum / static_cast<double>(rows.size());
}

double PolicyDivergence(const float* logits, const float* old_logits, double weight, float* by_logits) {
  const Categorical policy(logits);
  const Categorical old(old_logits);
  double divergence = 0;
  for (int i = 0; i < kNumActions; ++i) divergence += policy.probs[i] * (policy.log_probs[i] - old.log_probs[i]);
  for (int i = 0; i < kNumActions; ++i) {
    const double excess = policy.log_probs[i] - old.log_probs[i] - divergence;
    by_logits[i] = static_cast<float>(weight * policy.probs[i] * excess);
  }
  return divergence;
}

}  // namespace craftfleet
