// How the features of a frame change at an achievement.

#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include <absl/types/span.h>

namespace craftfleet {

// Writes (after - before), scaled to length 1; a change of length 0 stays 0. All three are float[F].
// Source: AGENTS.md, section 12.
inline void CodeChange(absl::Span<const float> before, absl::Span<const float> after, absl::Span<float> change) {
  constexpr double kLeastLength = 1e-12;
  double squares = 0;
  for (size_t i = 0; i < change.size(); ++i) {
    change[i] = after[i] - before[i];
    squares += double{change[i]} * change[i];
  }
  const double length = std::max(std::sqrt(squares), kLeastLength);
  for (float& x : change) x = static_cast<float>(x / length);
}

}  // namespace craftfleet
