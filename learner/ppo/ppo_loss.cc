#include "learner/ppo/ppo_loss.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "common/agent/categorical.h"

namespace craftfleet {

void PpoLossSums::Add(const PpoLossSums& other) {
  policy_loss += other.policy_loss;
  value_loss += other.value_loss;
  entropy += other.entropy;
  approx_kl += other.approx_kl;
  clipped += other.clipped;
}

PpoLossSums PpoLoss(absl::Span<const float> logits, absl::Span<const float> values, const PpoTargets& targets,
                    const v1::PpoConfig& config, int rows_in_batch, absl::Span<float> logits_gradient,
                    absl::Span<float> values_gradient) {
  const double low = 1 - config.clip();
  const double high = 1 + config.clip();
  PpoLossSums sums;
  for (size_t row = 0; row < values.size(); ++row) {
    const Categorical policy(&logits[row * kNumActions]);
    const int action = static_cast<int>(targets.actions[row]);
    const double advantage = targets.advantages[row];
    const double log_ratio = std::min<double>(policy.log_probs[action] - targets.log_probs[row], kMaxLogRatio);
    const double ratio = std::exp(log_ratio);
    const double plain = advantage * ratio;
    const double clipped = advantage * std::clamp(ratio, low, high);
    const double entropy = policy.Entropy();
    const double value_error = values[row] - targets.returns[row];

    sums.policy_loss -= std::min(plain, clipped);
    sums.value_loss += value_error * value_error;
    sums.entropy += entropy;
    sums.approx_kl += (ratio - 1) - log_ratio;
    sums.clipped += std::abs(ratio - 1) > config.clip() ? 1 : 0;

    // d(policy loss)/d(log probability): the clamp is flat outside its range, where the minimum may choose it.
    const double by_log_prob = plain <= clipped ? -plain : 0;
    for (int i = 0; i < kNumActions; ++i) {
      const double by_policy = by_log_prob * ((i == action ? 1 : 0) - policy.probs[i]);
      const double by_entropy = -policy.probs[i] * (policy.log_probs[i] + entropy);
      logits_gradient[row * kNumActions + i] =
          static_cast<float>((by_policy - config.entropy_coefficient() * by_entropy) / rows_in_batch);
    }
    values_gradient[row] = static_cast<float>(2 * config.value_coefficient() * value_error / rows_in_batch);
  }
  return sums;
}

void Normalise(absl::Span<float> advantages) {
  double sum = 0;
  for (const float x : advantages) sum += x;
  const double mean = sum / advantages.size();
  double squares = 0;
  for (const float x : advantages) squares += (x - mean) * (x - mean);
  const double deviation = std::sqrt(squares / std::max<size_t>(advantages.size() - 1, 1));
  for (float& x : advantages) x = static_cast<float>((x - mean) / (deviation + 1e-8));
}

}  // namespace craftfleet
