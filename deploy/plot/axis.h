// Round numbers along an axis: where it begins and ends, where its ticks stand, how they are written.

#ifndef CRAFTFLEET_DEPLOY_PLOT_AXIS_H_
#define CRAFTFLEET_DEPLOY_PLOT_AXIS_H_

#include <string>
#include <vector>

namespace craftfleet {

struct Axis {
  double low = 0;
  double high = 1;            // above low
  std::vector<double> ticks;  // ascending, equal steps, the first at low, the last at high
};

// An axis over low..high (finite, low <= high) in at most `most_steps` (2 or more) steps, each 1, 2, 2.5 or 5 times a
// power of ten.
Axis RoundAxis(double low, double high, int most_steps);

// "0", "2.5", "-3", "50k", "1.5M"
std::string TickText(double value);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_PLOT_AXIS_H_
