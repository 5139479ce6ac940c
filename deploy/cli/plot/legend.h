// The legend under a chart.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLOT_LEGEND_H_
#define CRAFTFLEET_DEPLOY_CLI_PLOT_LEGEND_H_

#include <string>
#include <vector>

#include <absl/types/span.h>

#include "deploy/cli/plot/canvas.h"

namespace craftfleet {

struct LegendEntry {
  std::string name;  // ASCII
  Stroke stroke;
};

class Legend {
 public:
  // Puts as many entries into a row as fit into `width` pixels.
  Legend(absl::Span<const LegendEntry> entries, double width);

  double height() const;  // pixels
  // `corner`: the upper left one.
  void Draw(const Point& corner, Canvas* canvas) const;

 private:
  std::vector<std::vector<LegendEntry>> rows_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLOT_LEGEND_H_
