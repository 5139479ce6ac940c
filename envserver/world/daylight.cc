#include "envserver/world/daylight.h"

#include <array>
#include <cmath>

namespace craftfleet {
namespace {

double ComputeDaylight(int64_t step) {
  constexpr double kPi = 3.141592653589793;
  const double progress = std::fmod(static_cast<double>(step) / 300, 1.0) + 0.3;
  return 1 - std::pow(std::abs(std::cos(kPi * progress)), 3.0);
}

// Of the first steps of an episode: most episodes end earlier.
constexpr int kKept = 1200;
std::array<double, kKept> FirstSteps() {
  std::array<double, kKept> daylight;
  for (int step = 0; step < kKept; ++step) daylight[step] = ComputeDaylight(step);
  return daylight;
}

}  // namespace

double Daylight(int64_t step) {
  static const std::array<double, kKept> first_steps = FirstSteps();
  return step < kKept ? first_steps[step] : ComputeDaylight(step);
}

}  // namespace craftfleet
