// The losses of distillation with their gradients by hand: no LibTorch, exact in double.

#ifndef CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_LOSS_H_
#define CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_LOSS_H_

#include <absl/types/span.h>

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
// gradients of the mean. Source: DISTILLATION.md, sections 3 and 4.
double ContrastiveLoss(absl::Span<const ContrastiveRow> rows, int size, double temperature);

// KL(new || old) of two policies, given as logits float[17], in nats. Writes `weight` times its gradient by the new
// logits, float[17].
double PolicyDivergence(const float* logits, const float* old_logits, double weight, float* by_logits);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_LOSS_H_
