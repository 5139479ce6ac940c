// Generalised advantage estimation (Schulman et al. 2016).

#pragma once

#include <absl/types/span.h>

#include "common/base/types.h"

namespace craftfleet {

struct GaeOptions {
  double gamma = 0.95;
  double lambda = 0.65;
  bool truncation_is_terminal = false;  // true: the length limit ends an episode like a death (PPO.md, section 8)
};

// Consecutive steps of one lane.
struct LaneSteps {
  absl::Span<const float> rewards;            // [T]
  absl::Span<const float> values;             // [T]
  absl::Span<const StepEnd> ends;             // [T]
  absl::Span<const float> truncation_values;  // [number of kTruncated in ends]: of each such episode's last frame
  float bootstrap_value = 0;                  // of the observation after the last step
};

// Writes advantages[T] and returns[T], which are advantages + values. T > 0. The arithmetic, its mix of float and
// double included, is that of the reference: golden agents/gae.json, bit for bit. Source: PPO.md, section 3.
void ComputeGae(const LaneSteps& steps, const GaeOptions& options, absl::Span<float> advantages,
                absl::Span<float> returns);

}  // namespace craftfleet
