// Bar charts: categories from top to bottom, each with a bar per series.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLOT_BAR_CHART_H_
#define CRAFTFLEET_DEPLOY_CLI_PLOT_BAR_CHART_H_

#include <optional>
#include <string>
#include <vector>

#include "deploy/cli/plot/canvas.h"

namespace craftfleet {

struct Bar {
  double value = 0;   // 0 or more
  double spread = 0;  // drawn as a whisker to both sides; 0: none
};

struct BarSeries {
  std::string name;  // ASCII, as all texts; empty: not in the legend
  Color color;
  std::vector<std::optional<Bar>> bars;  // [category]
  std::string missing;                   // the text in place of a missing bar; may be empty
};

struct BarChart {
  std::string title;
  std::string label;  // of the values
  std::vector<std::string> categories;
  std::vector<BarSeries> series;
};

// The picture as a PNG file. At least one category and one series; the axis begins at 0.
std::string DrawBars(const BarChart& chart);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLOT_BAR_CHART_H_
