// The range of an axis, its round ticks and their labels.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLOT_AXIS_H_
#define CRAFTFLEET_DEPLOY_CLI_PLOT_AXIS_H_

#include <string>
#include <vector>

namespace craftfleet {

struct Axis {
  double low = 0;
  double high = 1;            // above low
  std::vector<double> ticks;  // ascending, equal steps, the first at low, the last at high or below
};

// An axis over low..high (finite, low <= high) in at most `most_steps` (2 or more) steps, each 1, 2, 2.5 or 5 times a
// power of ten. The axis begins and ends at a tick.
Axis RoundAxis(double low, double high, int most_steps);

// The same, but the axis ends at `high`, where the data end.
Axis DataAxis(double low, double high, int most_steps);

// "0", "2.5", "-3", "50k", "1.5M"
std::string TickText(double value);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLOT_AXIS_H_
