// The categorical distribution over the 17 actions that a row of logits defines.

#pragma once

#include <array>

#include "common/base/crafter.h"

namespace craftfleet {

struct Categorical {
  std::array<double, kNumActions> log_probs;
  std::array<double, kNumActions> probs;

  // `logits` is float[17].
  explicit Categorical(const float* logits);

  // The action at `noise`, in [0, 1), of the cumulative distribution.
  Action Sample(double noise) const;
  // The most probable action; the first of equals.
  Action Greedy() const;
  // Nats, at most ln 17.
  double Entropy() const;
};

}  // namespace craftfleet
