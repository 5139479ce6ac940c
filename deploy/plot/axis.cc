#include "deploy/plot/axis.h"

#include <cmath>

#include <absl/strings/str_format.h>

namespace craftfleet {
namespace {

constexpr double kRoundFactors[] = {1, 2, 2.5, 5, 10};

// Ranges far smaller than their numbers would have ticks that look alike.
constexpr double kSmallestRange = 1e-6;

}  // namespace

Axis RoundAxis(double low, double high, int most_steps) {
  const double smallest = kSmallestRange * std::fmax(1, std::fmax(std::fabs(low), std::fabs(high)));
  if (high - low < smallest) high = low + smallest;
  Axis axis;
  for (double power = std::pow(10, std::floor(std::log10((high - low) / most_steps)));; power *= 10) {
    for (const double factor : kRoundFactors) {
      const double step = factor * power;
      // A hair within the step, so that 0.3 / 0.1 does not open a fourth one.
      const double first = std::floor(low / step + 1e-9);
      const double last = std::ceil(high / step - 1e-9);
      if (last - first > most_steps) continue;
      const int steps = static_cast<int>(last - first);
      for (int i = 0; i <= steps; ++i) axis.ticks.push_back((first + i) * step);
      axis.low = axis.ticks.front();
      axis.high = axis.ticks.back();
      return axis;
    }
  }
}

std::string TickText(double value) {
  const double size = std::fabs(value);
  if (size >= 1e6) return absl::StrFormat("%.6gM", value / 1e6);
  if (size >= 1e3) return absl::StrFormat("%.6gk", value / 1e3);
  return absl::StrFormat("%.6g", value);
}

}  // namespace craftfleet
