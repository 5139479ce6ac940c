// Heatmaps: tables of numbers with coloured cells.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLOT_HEATMAP_H_
#define CRAFTFLEET_DEPLOY_CLI_PLOT_HEATMAP_H_

#include <optional>
#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/cli/plot/canvas.h"

namespace craftfleet {

struct Heatmap {
  std::string title;  // texts are ASCII
  std::vector<std::string> rows;
  std::vector<std::string> columns;
  std::vector<std::vector<std::optional<double>>> values;  // [row][column]; nullopt is shown as "no run"
};

// A colour from dark blue (`share` is 0) through green to yellow (1), ever lighter: readable with any colour vision and
// in print.
Color HeatColor(double share);

// The picture as a PNG file: rows of `across` maps (1 or more) side by side, in order, with a common colour scale.
// There is at least one map, and each has at least one row and one column.
std::string DrawHeatmaps(absl::Span<const Heatmap> maps, int across);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLOT_HEATMAP_H_
