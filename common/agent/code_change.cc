#include "common/agent/code_change.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace craftfleet {

void CodeChange(absl::Span<const float> before, absl::Span<const float> after, absl::Span<float> change) {
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
