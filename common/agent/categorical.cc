#include "common/agent/categorical.h"

#include <algorithm>
#include <cmath>

namespace craftfleet {

Categorical::Categorical(const float* logits) {
  const double largest = *std::max_element(logits, logits + kNumActions);
  double sum = 0;
  for (int i = 0; i < kNumActions; ++i) {
    log_probs[i] = logits[i] - largest;
    probs[i] = std::exp(log_probs[i]);
    sum += probs[i];
  }
  const double log_sum = std::log(sum);
  for (int i = 0; i < kNumActions; ++i) {
    log_probs[i] -= log_sum;
    probs[i] /= sum;
  }
}

Action Categorical::Sample(double noise) const {
  double cumulative = 0;
  int action = 0;
  for (; action < kNumActions - 1; ++action) {
    cumulative += probs[action];
    if (noise < cumulative) break;
  }
  return static_cast<Action>(action);
}

Action Categorical::Greedy() const {
  return static_cast<Action>(std::max_element(log_probs.begin(), log_probs.end()) - log_probs.begin());
}

double Categorical::Entropy() const {
  double entropy = 0;
  for (int i = 0; i < kNumActions; ++i) entropy -= probs[i] * log_probs[i];
  return entropy;
}

}  // namespace craftfleet
