#include "learner/ppo/gae.h"

#include <cstddef>

#include "common/base/check.h"

namespace craftfleet {

void ComputeGae(const LaneSteps& steps, const GaeOptions& options, absl::Span<float> advantages,
                absl::Span<float> returns) {
  const float gamma = static_cast<float>(options.gamma);
  const double carry = static_cast<float>(options.gamma * options.lambda);
  const size_t count = steps.rewards.size();
  size_t truncations = steps.truncation_values.size();
  double error = 0;  // of the value after step t, as the steps from there on show it
  for (size_t t = count; t-- > 0;) {
    const bool is_last = t + 1 == count;
    float next_value = is_last ? steps.bootstrap_value : steps.values[t + 1];
    bool bootstraps = steps.ends[t] == StepEnd::kNone;
    if (steps.ends[t] == StepEnd::kTruncated) {
      CRAFTFLEET_CHECK(truncations > 0);
      next_value = steps.truncation_values[--truncations];
      bootstraps = !options.truncation_is_terminal;
    }
    const float future = bootstraps ? gamma * next_value : 0.0F;
    // The reference computes the last step's difference in double, because its flag "done" is one.
    const double delta = is_last ? static_cast<double>(steps.rewards[t]) + future - steps.values[t]
                                 : steps.rewards[t] + future - steps.values[t];
    const double later = steps.ends[t] == StepEnd::kNone ? carry * error : 0;
    error = delta + later;
    advantages[t] = static_cast<float>(error);
    returns[t] = advantages[t] + steps.values[t];
  }
  CRAFTFLEET_CHECK(truncations == 0);
}

}  // namespace craftfleet
