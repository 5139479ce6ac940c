#include "learner/ppo/value_norm.h"

#include <algorithm>
#include <cmath>

namespace craftfleet {

void ValueNorm::Update(absl::Span<const float> returns, double decay) {
  double sum = 0;
  double squares = 0;
  for (const float x : returns) {
    sum += x;
    squares += double{x} * x;
  }
  const auto count = static_cast<double>(returns.size());
  mean = decay * mean + (1 - decay) * (sum / count);
  mean_square = decay * mean_square + (1 - decay) * (squares / count);
  weight = decay * weight + (1 - decay);
}

ValueScale ValueNorm::Scale(double start) const {
  if (weight == 0) return {0, start};
  const double corrected = mean / weight;
  return {corrected, std::sqrt(std::max(mean_square / weight - corrected * corrected, kMinVariance))};
}

}  // namespace craftfleet
