#include "envserver/world/daylight.h"

#include <cmath>

namespace craftfleet {

double Daylight(int64_t step) {
  constexpr double kPi = 3.141592653589793;
  const double progress = std::fmod(static_cast<double>(step) / 300, 1.0) + 0.3;
  return 1 - std::pow(std::abs(std::cos(kPi * progress)), 3.0);
}

}  // namespace craftfleet
