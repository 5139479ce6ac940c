// Line charts: panels side by side, each with its axes, and one legend below.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLOT_CHART_H_
#define CRAFTFLEET_DEPLOY_CLI_PLOT_CHART_H_

#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/cli/plot/canvas.h"

namespace craftfleet {

// The range of a line's values at one point.
struct BandPoint {
  double x = 0;
  double low = 0;
  double high = 0;
};

struct ChartLine {
  std::string name;  // for the legend, ASCII; empty: not in the legend
  Stroke stroke;
  std::vector<Point> points;    // in the axes' units, x ascending
  std::vector<BandPoint> band;  // shaded beneath all lines, x ascending; may be empty
};

struct ChartPanel {
  std::string title;  // texts are ASCII
  std::string x_label;
  std::string y_label;
  std::vector<ChartLine> lines;  // the first is on top; the legend has those of the first panel
};

// Pixels of the whole picture.
struct ChartSize {
  int width = 1400;
  int height = 600;
};

// The picture as a PNG file. At least one panel. Axes begin at 0 or below; x axes end where the data end.
std::string DrawChart(absl::Span<const ChartPanel> panels, const ChartSize& size);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLOT_CHART_H_
