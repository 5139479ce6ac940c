// An optimiser step of distillation, with its random choices already made.

#ifndef CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_STEP_H_
#define CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_STEP_H_

#include <vector>

namespace craftfleet {

// The two losses, each with its own optimiser.
enum class DistillationLoss { kMatching, kPrediction };

// An anchor, which a positive should be like and a negative should not. The anchor is how features change from one
// frame to another.
struct Contrast {
  int before = 0;  // of the step's rows
  int after = 0;   // likewise; kNoFrame (goals.h): to zeros
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

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_STEP_H_
