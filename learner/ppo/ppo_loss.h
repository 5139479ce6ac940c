// PPO's loss with its gradient by hand: no LibTorch, exact in double.

#pragma once

#include <absl/types/span.h>

#include "common/base/crafter.h"
#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// Log ratios are cut to this. No policy that learns gets near it, but one actor's made-up log probability of -104 would
// otherwise overflow the gradient, and twice in a row end the run.
inline constexpr double kMaxLogRatio = 20;

// The loss compares the network's output with these.
struct PpoTargets {
  absl::Span<const Action> actions;    // [n]
  absl::Span<const float> log_probs;   // [n] of the policy around which ratios are clipped
  absl::Span<const float> advantages;  // [n] normalised, times importance weights
  absl::Span<const float> returns;     // [n]
};

// Sums over rows; divided by the number of rows they are the means of PPO.md, section 6.
struct PpoLossSums {
  double policy_loss = 0;
  double value_loss = 0;
  double entropy = 0;
  double approx_kl = 0;  // (ratio - 1) - log ratio
  double clipped = 0;    // rows with |ratio - 1| > clip

  void Add(const PpoLossSums& other);
};

// Of logits float[n,17] and values float[n]. Writes the gradient of (policy loss + value_coefficient * value loss -
// entropy_coefficient * entropy) summed over the rows and divided by `rows_in_batch`, so that the gradients of the
// parts of a minibatch add up to the minibatch's. The fields of `config` that count: clip and the two coefficients.
PpoLossSums PpoLoss(absl::Span<const float> logits, absl::Span<const float> values, const PpoTargets& targets,
                    const v1::PpoConfig& config, int rows_in_batch, absl::Span<float> logits_gradient,
                    absl::Span<float> values_gradient);

// (x - mean) / (standard deviation with n-1, + 1e-8), in place; a single number becomes 0. n > 0.
void Normalise(absl::Span<float> advantages);

}  // namespace craftfleet
