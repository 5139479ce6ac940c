#include "deploy/cli/plot/heatmap.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <absl/strings/str_format.h>

#include "deploy/cli/plot/look.h"

namespace craftfleet {
namespace {

// The colour map viridis (van der Walt and Smith 2015) at equal steps.
constexpr std::array<Color, 9> kHeat = {{{68, 1, 84},
                                         {71, 44, 122},
                                         {59, 81, 139},
                                         {44, 113, 142},
                                         {33, 144, 141},
                                         {39, 173, 129},
                                         {92, 200, 99},
                                         {170, 220, 50},
                                         {253, 231, 37}}};
constexpr Color kMissing = {236, 236, 236};
constexpr Color kMissingText = {120, 120, 120};
constexpr char kMissingWord[] = "no run";

// Pixels.
constexpr double kMargin = 24;
constexpr double kTitleRow = 34;
constexpr double kLabelRow = 24;  // the columns' labels
constexpr double kRow = 28;
constexpr double kLabelGap = 10;
constexpr double kNarrowestColumn = 56;
constexpr double kScaleRow = 52;
constexpr double kScaleLength = 260;
constexpr double kScaleHeight = 12;

struct Scale {
  double low = 0;
  double high = 1;
  double ShareOf(double value) const { return high > low ? (value - low) / (high - low) : 0.5; }
};

Scale ScaleOf(absl::Span<const Heatmap> maps) {
  std::vector<double> all;
  for (const Heatmap& map : maps) {
    for (const auto& row : map.values) {
      for (const std::optional<double>& value : row) {
        if (value.has_value()) all.push_back(*value);
      }
    }
  }
  if (all.empty()) return {};
  const auto [low, high] = std::minmax_element(all.begin(), all.end());
  return {*low, *high};
}

double WidestOf(const std::vector<std::string>& texts) {
  double width = 0;
  for (const std::string& text : texts) width = std::max(width, Canvas::TextWidth(text, kTextSize));
  return width;
}

// The layout of one map on the canvas, pixels.
struct Layout {
  double labels = 0;  // the rows' labels
  double column = 0;
  double width = 0;
  double height = 0;
};

Layout LayoutOf(const Heatmap& map) {
  Layout layout;
  layout.labels = WidestOf(map.rows) + kLabelGap;
  layout.column = std::max(kNarrowestColumn, WidestOf(map.columns) + kLabelGap);
  layout.width = std::max(layout.labels + layout.column * static_cast<double>(map.columns.size()),
                          layout.labels + Canvas::TextWidth(map.title, kTitleSize));
  layout.height = kTitleRow + kLabelRow + kRow * static_cast<double>(map.rows.size());
  return layout;
}

void DrawCell(const std::optional<double>& value, const Scale& scale, const Point& corner, double width,
              Canvas* canvas) {
  const double share = value.has_value() ? scale.ShareOf(*value) : 0;
  canvas->FillRectangle(corner, {corner.x + width - 2, corner.y + kRow - 2},
                        value.has_value() ? HeatColor(share) : kMissing);
  const std::string text = value.has_value() ? absl::StrFormat("%.1f", *value) : kMissingWord;
  const Color color = !value.has_value() ? kMissingText : share > 0.55 ? Color{0, 0, 0} : Color{255, 255, 255};
  canvas->DrawText(text, {corner.x + width / 2 - 1, corner.y + kRow / 2 + kTextSize / 2 - 1}, TextPlace::kCenter,
                   kTextSize, color);
}

void DrawMap(const Heatmap& map, const Layout& layout, const Scale& scale, const Point& corner, Canvas* canvas) {
  const double left = corner.x + layout.labels;
  canvas->DrawText(map.title, {left, corner.y + kTitleSize}, TextPlace::kLeft, kTitleSize, kTextColor);
  for (size_t c = 0; c < map.columns.size(); ++c) {
    const double middle = left + layout.column * (static_cast<double>(c) + 0.5) - 1;
    canvas->DrawText(map.columns[c], {middle, corner.y + kTitleRow + kTextSize}, TextPlace::kCenter, kTextSize,
                     kTextColor);
  }
  for (size_t r = 0; r < map.rows.size(); ++r) {
    const double top = corner.y + kTitleRow + kLabelRow + kRow * static_cast<double>(r);
    canvas->DrawText(map.rows[r], {left - kLabelGap, top + kRow / 2 + kTextSize / 2 - 1}, TextPlace::kRight, kTextSize,
                     kTextColor);
    for (size_t c = 0; c < map.columns.size(); ++c) {
      DrawCell(map.values[r][c], scale, {left + layout.column * static_cast<double>(c), top}, layout.column, canvas);
    }
  }
}

void DrawScale(const Scale& scale, const Point& corner, Canvas* canvas) {
  for (int i = 0; i < static_cast<int>(kScaleLength); ++i) {
    canvas->FillRectangle({corner.x + i, corner.y}, {corner.x + i + 1, corner.y + kScaleHeight},
                          HeatColor(i / (kScaleLength - 1)));
  }
  const double text = corner.y + kScaleHeight + 6 + kTextSize;
  canvas->DrawText(absl::StrFormat("%.1f", scale.low), {corner.x, text}, TextPlace::kLeft, kTextSize, kTextColor);
  canvas->DrawText(absl::StrFormat("%.1f", scale.high), {corner.x + kScaleLength, text}, TextPlace::kRight, kTextSize,
                   kTextColor);
}

}  // namespace

Color HeatColor(double share) {
  const double place = std::clamp(share, 0.0, 1.0) * (kHeat.size() - 1);
  const auto below = std::min(static_cast<size_t>(place), kHeat.size() - 2);
  const double part = place - static_cast<double>(below);
  const auto mix = [part](uint8_t from, uint8_t to) {
    return static_cast<uint8_t>(std::lround(from + (to - from) * part));
  };
  const Color& from = kHeat[below];
  const Color& to = kHeat[below + 1];
  return {mix(from.red, to.red), mix(from.green, to.green), mix(from.blue, to.blue)};
}

std::string DrawHeatmaps(absl::Span<const Heatmap> maps, int across) {
  Layout largest;
  std::vector<Layout> layouts;
  for (const Heatmap& map : maps) {
    layouts.push_back(LayoutOf(map));
    largest.width = std::max(largest.width, layouts.back().width);
    largest.height = std::max(largest.height, layouts.back().height);
  }
  across = std::min(across, static_cast<int>(maps.size()));
  const int down = (static_cast<int>(maps.size()) + across - 1) / across;
  const double step_x = largest.width + kMargin;
  const double step_y = largest.height + kMargin;
  Canvas canvas(static_cast<int>(std::ceil(kMargin + step_x * across)),
                static_cast<int>(std::ceil(kMargin + step_y * down + kScaleRow)));
  const Scale scale = ScaleOf(maps);
  for (size_t i = 0; i < maps.size(); ++i) {
    const int column = static_cast<int>(i) % across;
    const int row = static_cast<int>(i) / across;
    DrawMap(maps[i], layouts[i], scale, {kMargin + step_x * column, kMargin + step_y * row}, &canvas);
  }
  DrawScale(scale, {kMargin + layouts[0].labels, kMargin + step_y * down}, &canvas);
  return canvas.EncodePng();
}

}  // namespace craftfleet
