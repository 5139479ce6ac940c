// The losses of distillation with their gradients by hand: no LibTorch, exact in double.

#ifndef CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_LOSS_H_
#define CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_LOSS_H_

#include <cstddef>
#include <vector>

#include <absl/types/span.h>

#include "common/base/crafter.h"
#include "learner/ppo/distillation/distillation_step.h"

namespace craftfleet {

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

#endif  // CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_LOSS_H_
