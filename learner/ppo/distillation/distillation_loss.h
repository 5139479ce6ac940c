// An optimiser step of distillation, with its random choices already made, and its losses with their gradients by hand:
// no LibTorch, exact in double.

#pragma once

#include <cstddef>
#include <vector>

#include <absl/status/status.h>
#include <absl/types/span.h>

#include "common/base/crafter.h"

namespace craftfleet {

// The two losses, each with its own optimiser.
enum class DistillationLoss { kMatching, kPrediction };

// An anchor, which a positive should be like and a negative should not. The anchor is how features change from one
// frame to another.
struct Contrast {
  int before = 0;  // of the step's rows
  int after = 0;   // likewise; kNoFrame (kept_rollouts.h): to zeros
  // In matching: of the changes that DistillationNet::Changes computed last. In prediction: of the step's rows, whose
  // predictions these are; a row is the positive of one contrast at most, and the negative of one.
  int positive = 0;
  int negative = 0;
};

// Features and anchors have gradients in matching, predictions in prediction.
struct DistillationStep {
  DistillationLoss loss = DistillationLoss::kMatching;
  double temperature = 0.1;
  std::vector<int> rows;  // of the rollouts, distinct
  std::vector<Contrast> contrasts;
  // In keeping policy and value, by row:
  std::vector<double> weights;  // their sum is 1
  std::vector<float> targets;   // returns, normalised
};

// Means over the rows of a step, or their sums over steps.
struct DistillationLosses {
  double contrastive = 0;
  double divergence = 0;     // KL(new policy || old one), nats
  double value = 0;          // squared error of normalised values
  double gradient_norm = 0;  // L2, before clipping
};

// DataLoss: the norm of a gradient, or a sum of norms, is not finite.
absl::Status CheckNorm(double norm);

// Three vectors float[F], of any length, and where their gradients are added to; null: the vector is a constant.
struct ContrastiveRow {
  const float* anchor = nullptr;
  const float* positive = nullptr;
  const float* negative = nullptr;
  float* by_anchor = nullptr;
  float* by_positive = nullptr;
  float* by_negative = nullptr;
};

// Mean over the rows of softplus((x.n - x.p) / temperature), with anchor x, positive p and negative n scaled to length
// 1 (zero stays zero and gets no gradient): the cross-entropy of telling the positive from the negative. Adds the
// gradients. Source: DISTILLATION.md, section 2.
double ContrastiveLoss(absl::Span<const ContrastiveRow> rows, int size, double temperature);

// KL(new || old) of two policies, given as logits float[17], in nats. Writes `weight` times its gradient by the new
// logits, float[17].
double PolicyDivergence(const float* logits, const float* old_logits, double weight, float* by_logits);

// Of n rows: the network's outputs, or gradients by them.
struct NetNumbers {
  // `predicts`: with predictions.
  NetNumbers(size_t rows, int code_size, bool predicts)
      : logits(rows * kNumActions),
        values(rows),
        codes(rows * code_size),
        predictions(predicts ? rows * code_size : 0),
        width(code_size) {}

  const float* code(int row) const { return &codes[static_cast<size_t>(row) * width]; }
  float* code(int row) { return &codes[static_cast<size_t>(row) * width]; }
  const float* prediction(int row) const { return &predictions[static_cast<size_t>(row) * width]; }
  float* prediction(int row) { return &predictions[static_cast<size_t>(row) * width]; }

  std::vector<float> logits;       // [n,17]
  std::vector<float> values;       // [n]
  std::vector<float> codes;        // [n,width] features
  std::vector<float> predictions;  // [n,width] of the goal predictor, or empty
  int width;
};

// The losses of a step, without the gradient's norm. `changes` float[,F] are those that contrasts of matching name,
// `old_logits` float[,17] those of all rows of the rollouts. `gradients` comes with zeros and gets the gradients by the
// outputs.
DistillationLosses StepLosses(const DistillationStep& step, const NetNumbers& outputs, absl::Span<const float> changes,
                              absl::Span<const float> old_logits, NetNumbers* gradients);

}  // namespace craftfleet
