#include "learner/ppo/value_norm.h"

#include <algorithm>
#include <cmath>

#include <absl/strings/str_format.h>

namespace craftfleet {

ValueRange ValueScale::Outputs() const { return {(-kMaxValue - mean) / deviation, (kMaxValue - mean) / deviation}; }

ValueRange AcceptedOutputs(const v1::PpoConfig& config, const ValueScale& scale) {
  return config.value_norm_decay() > 0 ? scale.Outputs() : ValueRange();
}

absl::Status ValueNorm::Check() const {
  constexpr double kSlack = 1e-6;
  const double most = weight * kMaxReturn;
  const bool is_possible = weight >= 0 && weight <= 1 + kSlack && std::abs(mean) <= most && mean_square >= 0 &&
                           mean_square <= most * kMaxReturn;
  if (is_possible) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrFormat(
      "the statistics of returns are mean %g, mean square %g and weight %g, want those of returns within +-%g and a "
      "weight of 0..1",
      mean, mean_square, weight, kMaxReturn));
}

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
