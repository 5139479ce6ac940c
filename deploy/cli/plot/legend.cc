#include "deploy/cli/plot/legend.h"

#include <cmath>

#include "deploy/cli/plot/look.h"

namespace craftfleet {
namespace {

// Pixels.
constexpr double kRow = 26;
constexpr double kStroke = 42;
constexpr double kGap = 36;

double WidthOf(const LegendEntry& entry) { return kStroke + Canvas::TextWidth(entry.name, kTextSize) + kGap; }

}  // namespace

Legend::Legend(absl::Span<const LegendEntry> entries, double width) {
  double used = width;
  for (const LegendEntry& entry : entries) {
    if (used + WidthOf(entry) > width) {
      rows_.emplace_back();
      used = 0;
    }
    rows_.back().push_back(entry);
    used += WidthOf(entry);
  }
}

double Legend::height() const { return kRow * static_cast<double>(rows_.size()); }

void Legend::Draw(const Point& corner, Canvas* canvas) const {
  double y = corner.y + kRow / 2;
  for (const auto& row : rows_) {
    double x = corner.x;
    for (const LegendEntry& entry : row) {
      const double cap = std::floor(entry.stroke.width / 4) * 2;  // thick lines end round
      canvas->DrawLine({{x + cap, y}, {x + kStroke - 8 - cap, y}}, entry.stroke);
      canvas->DrawText(entry.name, {x + kStroke, y + kTextSize / 2}, TextPlace::kLeft, kTextSize, kTextColor);
      x += WidthOf(entry);
    }
    y += kRow;
  }
}

}  // namespace craftfleet
