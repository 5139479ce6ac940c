// Generalised advantage estimation (Schulman et al. 2016), off-policy with V-trace's weights (Espeholt et al. 2018).

#ifndef CRAFTFLEET_LEARNER_PPO_GAE_H_
#define CRAFTFLEET_LEARNER_PPO_GAE_H_

#include <absl/types/span.h>

#include "common/base/types.h"

namespace craftfleet {

struct GaeOptions {
  double gamma = 0.95;
  double lambda = 0.65;
  bool truncation_is_terminal = false;  // true: the length limit ends an episode like a death (PPO.md, section 8)
  double rho_bar = 0;  // with LaneSteps::ratios: bounds of the weights of temporal differences and of what follows
  double c_bar = 0;
};

// Consecutive steps of one lane.
struct LaneSteps {
  absl::Span<const float> rewards;            // [T]
  absl::Span<const float> values;             // [T]
  absl::Span<const StepEnd> ends;             // [T]
  absl::Span<const float> truncation_values;  // [number of kTruncated in ends]: of each such episode's last frame
  float bootstrap_value = 0;                  // of the observation after the last step
  // [T] the probability of each action under the policy that is to be evaluated, divided by that under the policy which
  // played. Empty: they are the same.
  absl::Span<const double> ratios = {};
};

// Writes advantages[T] and returns[T], which without ratios are advantages + values. T > 0. The arithmetic, its mix of
// float and double included, is that of the reference: golden agents/gae.json, bit for bit.
// Source: PPO.md, sections 3 and 10.
void ComputeGae(const LaneSteps& steps, const GaeOptions& options, absl::Span<float> advantages,
                absl::Span<float> returns);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_GAE_H_
