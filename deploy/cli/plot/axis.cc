#include "deploy/cli/plot/axis.h"

#include <cmath>

#include <absl/strings/str_format.h>

namespace craftfleet {
namespace {

constexpr double kRoundFactors[] = {1, 2, 2.5, 5, 10};

// In a range that is much smaller than its values, all ticks would have the same label.
constexpr double kSmallestRange = 1e-6;

double SmallestRange(double low, double high) {
  return kSmallestRange * std::fmax(1, std::fmax(std::fabs(low), std::fabs(high)));
}

}  // namespace

Axis RoundAxis(double low, double high, int most_steps) {
  high = std::fmax(high, low + SmallestRange(low, high));
  Axis axis;
  for (double power = std::pow(10, std::floor(std::log10((high - low) / most_steps)));; power *= 10) {
    for (const double factor : kRoundFactors) {
      const double step = factor * power;
      // Tolerates rounding errors, so that 0.3 / 0.1 gives three steps, not four.
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

Axis DataAxis(double low, double high, int most_steps) {
  Axis axis = RoundAxis(low, high, most_steps);
  if (high - axis.low < SmallestRange(low, high)) return axis;
  const double rounding = 1e-9 * (axis.high - axis.low);
  axis.high = high;
  while (axis.ticks.back() > high + rounding) axis.ticks.pop_back();
  return axis;
}

std::string TickText(double value) {
  const double size = std::fabs(value);
  if (size >= 1e6) return absl::StrFormat("%.6gM", value / 1e6);
  if (size >= 1e3) return absl::StrFormat("%.6gk", value / 1e3);
  return absl::StrFormat("%.6g", value);
}

}  // namespace craftfleet
