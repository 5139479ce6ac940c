// Heatmaps: tables of numbers whose cells are coloured by them.

#ifndef CRAFTFLEET_DEPLOY_PLOT_HEATMAP_H_
#define CRAFTFLEET_DEPLOY_PLOT_HEATMAP_H_

#include <optional>
#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/plot/canvas.h"

namespace craftfleet {

struct Heatmap {
  std::string title;  // texts are ASCII
  std::vector<std::string> rows;
  std::vector<std::string> columns;
  std::vector<std::vector<std::optional<double>>> values;  // [row][column]; without one the cell says so
};

// From dark blue over green to yellow as `share` goes from 0 to 1, ever lighter: alike for people with any colour
// vision and in print.
Color HeatColor(double share);

// The picture as a PNG file: `across` (1 or more) maps side by side, in order, one scale of colours for all. At least
// one map; each has a row and a column.
std::string DrawHeatmaps(absl::Span<const Heatmap> maps, int across);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_PLOT_HEATMAP_H_
