// Normalised value targets: the value head predicts returns with their running mean and variance taken out.

#pragma once

#include <cstdint>

#include <absl/status/status.h>
#include <absl/types/span.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// The largest absolute value that a critic of normalised values may have: many times what a game can give (crafter.h),
// which no critic that learns exceeds.
inline constexpr double kMaxValue = 1000;
// Of a return from such values: at most the rewards of a whole episode more.
inline constexpr double kMaxReturn = kMaxValue + 25;

// The outputs of a value head that fragments may have. By default those whose squares and sums stay finite
// (wire::kMaxValue).
struct ValueRange {
  double low = -1e6;
  double high = 1e6;
};

// value = mean + deviation * output of the value head.
struct ValueScale {
  double mean = 0;
  double deviation = 1;

  float Denormalise(float value) const { return static_cast<float>(mean + deviation * value); }
  float Normalise(float value) const { return static_cast<float>((value - mean) / deviation); }
  // The outputs of the value head that stand for values within +-kMaxValue.
  ValueRange Outputs() const;
};

// The outputs that fragments may have which weights with this `scale` played.
ValueRange AcceptedOutputs(const v1::PpoConfig& config, const ValueScale& scale);

// Running mean and mean square of the targets, exponentially weighted: a step's share in them decays by `decay` with
// each minibatch that comes after it. `weight` is what all shares add up to; dividing by it corrects the bias towards
// the zeros that they start from.
// Source: PPO.md, section 9.
struct ValueNorm {
  static constexpr double kMinVariance = 0.01;  // of Scale

  double mean = 0;         // not corrected
  double mean_square = 0;  // likewise
  double weight = 0;       // 0: no targets yet

  // Adds a minibatch of returns, n > 0. `decay` is in (0, 1).
  void Update(absl::Span<const float> returns, double decay);

  //   InvalidArgument: no returns within +-kMaxReturn have these statistics.
  absl::Status Check() const;

  // With a variance of at least kMinVariance; mean 0 and deviation `start` before the first Update.
  ValueScale Scale(double start = 1) const;
};

}  // namespace craftfleet
