#include "deploy/cli/plot/chart.h"

#include <algorithm>

#include "deploy/cli/plot/axis.h"
#include "deploy/cli/plot/legend.h"
#include "deploy/cli/plot/look.h"

namespace craftfleet {
namespace {

// Pixels.
constexpr double kLeft = 80;  // of a panel: room for the y axis' numbers and label
constexpr double kRight = 30;
constexpr double kTop = 50;
constexpr double kBottom = 62;
constexpr double kMargin = 18;
constexpr double kPixelsPerTickX = 85;
constexpr double kPixelsPerTickY = 50;

constexpr double kBandOpacity = 0.18;

// The area of a panel's data on the canvas.
struct Frame {
  double left, top, right, bottom;  // pixels
  Axis x, y;

  Point At(const Point& point) const {
    return {left + (point.x - x.low) / (x.high - x.low) * (right - left),
            bottom - (point.y - y.low) / (y.high - y.low) * (bottom - top)};
  }
};

Frame FrameOf(const ChartPanel& panel, double left, double right, double bottom) {
  Point low;
  Point high;
  for (const ChartLine& line : panel.lines) {
    for (const Point& point : line.points) {
      low = {std::min(low.x, point.x), std::min(low.y, point.y)};
      high = {std::max(high.x, point.x), std::max(high.y, point.y)};
    }
    for (const BandPoint& point : line.band) {
      low = {std::min(low.x, point.x), std::min(low.y, point.low)};
      high = {std::max(high.x, point.x), std::max(high.y, point.high)};
    }
  }
  Frame frame = {left + kLeft, kTop, right - kRight, bottom - kBottom, {}, {}};
  frame.x = DataAxis(low.x, high.x, std::max(2, static_cast<int>((frame.right - frame.left) / kPixelsPerTickX)));
  frame.y = RoundAxis(low.y, high.y, std::max(2, static_cast<int>((frame.bottom - frame.top) / kPixelsPerTickY)));
  return frame;
}

void DrawAxes(const ChartPanel& panel, const Frame& frame, Canvas* canvas) {
  const double middle = (frame.left + frame.right) / 2;
  canvas->DrawText(panel.title, {middle, frame.top - 18}, TextPlace::kCenter, kTitleSize, kTextColor);
  for (const double tick : frame.x.ticks) {
    const double x = frame.At({tick, 0}).x;
    canvas->DrawLine({{x, frame.top}, {x, frame.bottom}}, {kGridColor});
    canvas->DrawText(TickText(tick), {x, frame.bottom + 8 + kTextSize}, TextPlace::kCenter, kTextSize, kTextColor);
  }
  for (const double tick : frame.y.ticks) {
    const double y = frame.At({0, tick}).y;
    canvas->DrawLine({{frame.left, y}, {frame.right, y}}, {kGridColor});
    canvas->DrawText(TickText(tick), {frame.left - 8, y + kTextSize / 2}, TextPlace::kRight, kTextSize, kTextColor);
  }
  canvas->DrawLine({{frame.left, frame.top}, {frame.left, frame.bottom}, {frame.right, frame.bottom}},
                   {kFrameColor, 1.2});
  canvas->DrawText(panel.x_label, {middle, frame.bottom + 30 + kTextSize}, TextPlace::kCenter, kTextSize, kTextColor);
  canvas->DrawTextUpwards(panel.y_label, {frame.left - 60, (frame.top + frame.bottom) / 2}, kTextSize, kTextColor);
}

void DrawBand(const ChartLine& line, const Frame& frame, Canvas* canvas) {
  std::vector<Point> outline;
  outline.reserve(2 * line.band.size());
  for (const BandPoint& point : line.band) outline.push_back(frame.At({point.x, point.high}));
  for (auto point = line.band.rbegin(); point != line.band.rend(); ++point) {
    outline.push_back(frame.At({point->x, point->low}));
  }
  canvas->FillPolygon(outline, line.stroke.color, kBandOpacity);
}

void DrawPanel(const ChartPanel& panel, const Frame& frame, Canvas* canvas) {
  DrawAxes(panel, frame, canvas);
  for (auto line = panel.lines.rbegin(); line != panel.lines.rend(); ++line) DrawBand(*line, frame, canvas);
  for (auto line = panel.lines.rbegin(); line != panel.lines.rend(); ++line) {
    std::vector<Point> points;
    points.reserve(line->points.size());
    for (const Point& point : line->points) points.push_back(frame.At(point));
    canvas->DrawLine(points, line->stroke);
  }
}

Legend LegendOf(const std::vector<ChartLine>& lines, double width) {
  std::vector<LegendEntry> entries;
  for (const ChartLine& line : lines) {
    if (!line.name.empty()) entries.push_back({line.name, line.stroke});
  }
  return Legend(entries, width);
}

}  // namespace

std::string DrawChart(absl::Span<const ChartPanel> panels, const ChartSize& size) {
  Canvas canvas(size.width, size.height);
  const Legend legend = LegendOf(panels.front().lines, size.width - kLeft - kRight);
  const double bottom = size.height - kMargin - legend.height();
  const double panel_width = static_cast<double>(size.width) / static_cast<double>(panels.size());
  for (size_t i = 0; i < panels.size(); ++i) {
    const double left = panel_width * static_cast<double>(i);
    DrawPanel(panels[i], FrameOf(panels[i], left, left + panel_width, bottom), &canvas);
  }
  legend.Draw({kLeft, bottom}, &canvas);
  return canvas.EncodePng();
}

}  // namespace craftfleet
