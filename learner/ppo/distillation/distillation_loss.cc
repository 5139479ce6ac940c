#include "learner/ppo/distillation/distillation_loss.h"

#include <cmath>
#include <cstddef>
#include <vector>

#include <absl/strings/str_cat.h>

#include "common/agent/categorical.h"
#include "learner/ppo/distillation/kept_rollouts.h"

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

// Writes how features change between the contrast's frames: float[width].
void WriteAnchor(const NetNumbers& outputs, const Contrast& contrast, float* anchor) {
  const float* const before = outputs.code(contrast.before);
  const float* const after = contrast.after == kNoFrame ? nullptr : outputs.code(contrast.after);
  for (int i = 0; i < outputs.width; ++i) anchor[i] = (after == nullptr ? 0.0F : after[i]) - before[i];
}

double MatchingLoss(const DistillationStep& step, const NetNumbers& outputs, absl::Span<const float> changes,
                    NetNumbers* gradients) {
  const int size = outputs.width;
  std::vector<float> anchors(step.contrasts.size() * 2 * size);  // each with the gradient by it
  std::vector<ContrastiveRow> rows;
  for (const Contrast& contrast : step.contrasts) {
    float* const anchor = &anchors[rows.size() * 2 * size];
    WriteAnchor(outputs, contrast, anchor);
    rows.push_back({anchor, &changes[static_cast<size_t>(contrast.positive) * size],
                    &changes[static_cast<size_t>(contrast.negative) * size], anchor + size, nullptr, nullptr});
  }
  const double loss = ContrastiveLoss(rows, size, step.temperature);
  for (size_t row = 0; row < rows.size(); ++row) {
    float* const by_before = gradients->code(step.contrasts[row].before);
    float* const by_after = gradients->code(step.contrasts[row].after);
    for (int i = 0; i < size; ++i) {
      by_before[i] -= rows[row].by_anchor[i];
      by_after[i] += rows[row].by_anchor[i];
    }
  }
  return loss;
}

double PredictionLoss(const DistillationStep& step, const NetNumbers& outputs, NetNumbers* gradients) {
  const int size = outputs.width;
  std::vector<float> anchors(step.contrasts.size() * size);
  std::vector<ContrastiveRow> rows;
  for (const Contrast& contrast : step.contrasts) {
    float* const anchor = &anchors[rows.size() * size];
    WriteAnchor(outputs, contrast, anchor);
    rows.push_back({anchor, outputs.prediction(contrast.positive), outputs.prediction(contrast.negative), nullptr,
                    gradients->prediction(contrast.positive), gradients->prediction(contrast.negative)});
  }
  return ContrastiveLoss(rows, size, step.temperature);
}

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

absl::Status CheckNorm(double norm) {
  if (std::isfinite(norm)) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat("distillation: the gradient's norm is ", norm));
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

DistillationLosses StepLosses(const DistillationStep& step, const NetNumbers& outputs, absl::Span<const float> changes,
                              absl::Span<const float> old_logits, NetNumbers* gradients) {
  DistillationLosses losses;
  losses.contrastive = step.loss == DistillationLoss::kMatching ? MatchingLoss(step, outputs, changes, gradients)
                                                                : PredictionLoss(step, outputs, gradients);
  for (size_t i = 0; i < step.rows.size(); ++i) {
    const double weight = step.weights[i];
    const float* const old = &old_logits[static_cast<size_t>(step.rows[i]) * kNumActions];
    losses.divergence +=
        weight * PolicyDivergence(&outputs.logits[i * kNumActions], old, weight, &gradients->logits[i * kNumActions]);
    const double error = double{outputs.values[i]} - step.targets[i];
    losses.value += weight * error * error;
    gradients->values[i] = static_cast<float>(2 * weight * error);
  }
  return losses;
}

}  // namespace craftfleet
