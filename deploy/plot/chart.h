// Line charts: panels side by side, each with axes, and one legend under them.

#ifndef CRAFTFLEET_DEPLOY_PLOT_CHART_H_
#define CRAFTFLEET_DEPLOY_PLOT_CHART_H_

#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/plot/canvas.h"

namespace craftfleet {

// How far a line's values spread at a place.
struct BandPoint {
  double x = 0;
  double low = 0;
  double high = 0;
};

struct ChartLine {
  std::string name;  // for the legend, ASCII; without one it is not in the legend
  Stroke stroke;
  std::vector<Point> points;    // in the axes' units, x ascending
  std::vector<BandPoint> band;  // shaded beneath all lines, x ascending; may be empty
};

struct ChartPanel {
  std::string title;  // texts are ASCII
  std::string x_label;
  std::string y_label;
  std::vector<ChartLine> lines;  // the first on top; those of the first panel stand in the legend
};

// Pixels of the whole picture.
struct ChartSize {
  int width = 1400;
  int height = 600;
};

// The picture as a PNG file. At least one panel; axes begin at 0 or below.
std::string DrawChart(absl::Span<const ChartPanel> panels, const ChartSize& size);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_PLOT_CHART_H_
