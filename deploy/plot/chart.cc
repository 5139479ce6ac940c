#include "deploy/plot/chart.h"

#include <algorithm>

#include "deploy/plot/axis.h"

namespace craftfleet {
namespace {

constexpr Color kText = {40, 40, 40};
constexpr Color kGrid = {228, 228, 228};
constexpr Color kFrame = {130, 130, 130};

// Pixels.
constexpr double kTitleSize = 12;
constexpr double kTextSize = 10;
constexpr double kLeft = 80;  // of a panel: room for the y axis' numbers and label
constexpr double kRight = 30;
constexpr double kTop = 50;
constexpr double kBottom = 62;
constexpr double kLegendRow = 26;
constexpr double kLegendStroke = 42;
constexpr double kLegendGap = 36;
constexpr double kMargin = 18;
constexpr double kPixelsPerTickX = 85;
constexpr double kPixelsPerTickY = 50;

// Where a panel's data lie on the canvas.
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
  }
  Frame frame = {left + kLeft, kTop, right - kRight, bottom - kBottom, {}, {}};
  frame.x = RoundAxis(low.x, high.x, std::max(2, static_cast<int>((frame.right - frame.left) / kPixelsPerTickX)));
  frame.y = RoundAxis(low.y, high.y, std::max(2, static_cast<int>((frame.bottom - frame.top) / kPixelsPerTickY)));
  return frame;
}

void DrawAxes(const ChartPanel& panel, const Frame& frame, Canvas* canvas) {
  const double middle = (frame.left + frame.right) / 2;
  canvas->DrawText(panel.title, {middle, frame.top - 18}, TextPlace::kCenter, kTitleSize, kText);
  for (const double tick : frame.x.ticks) {
    const double x = frame.At({tick, 0}).x;
    canvas->DrawLine({{x, frame.top}, {x, frame.bottom}}, {kGrid});
    canvas->DrawText(TickText(tick), {x, frame.bottom + 8 + kTextSize}, TextPlace::kCenter, kTextSize, kText);
  }
  for (const double tick : frame.y.ticks) {
    const double y = frame.At({0, tick}).y;
    canvas->DrawLine({{frame.left, y}, {frame.right, y}}, {kGrid});
    canvas->DrawText(TickText(tick), {frame.left - 8, y + kTextSize / 2}, TextPlace::kRight, kTextSize, kText);
  }
  canvas->DrawLine({{frame.left, frame.top}, {frame.left, frame.bottom}, {frame.right, frame.bottom}}, {kFrame, 1.2});
  canvas->DrawText(panel.x_label, {middle, frame.bottom + 30 + kTextSize}, TextPlace::kCenter, kTextSize, kText);
  canvas->DrawTextUpwards(panel.y_label, {frame.left - 60, (frame.top + frame.bottom) / 2}, kTextSize, kText);
}

void DrawPanel(const ChartPanel& panel, const Frame& frame, Canvas* canvas) {
  DrawAxes(panel, frame, canvas);
  for (auto line = panel.lines.rbegin(); line != panel.lines.rend(); ++line) {
    std::vector<Point> points;
    points.reserve(line->points.size());
    for (const Point& point : line->points) points.push_back(frame.At(point));
    canvas->DrawLine(points, line->stroke);
  }
}

// The legend's entries, row by row, as many in a row as fit.
std::vector<std::vector<const ChartLine*>> LegendRows(const std::vector<ChartLine>& lines, double width) {
  std::vector<std::vector<const ChartLine*>> rows;
  double used = width;
  for (const ChartLine& line : lines) {
    const double entry = kLegendStroke + Canvas::TextWidth(line.name, kTextSize) + kLegendGap;
    if (used + entry > width) {
      rows.emplace_back();
      used = 0;
    }
    rows.back().push_back(&line);
    used += entry;
  }
  return rows;
}

void DrawLegend(const std::vector<std::vector<const ChartLine*>>& rows, const Point& corner, Canvas* canvas) {
  double y = corner.y;
  for (const auto& row : rows) {
    double x = corner.x;
    for (const ChartLine* line : row) {
      canvas->DrawLine({{x, y}, {x + kLegendStroke - 8, y}}, line->stroke);
      canvas->DrawText(line->name, {x + kLegendStroke, y + kTextSize / 2}, TextPlace::kLeft, kTextSize, kText);
      x += kLegendStroke + Canvas::TextWidth(line->name, kTextSize) + kLegendGap;
    }
    y += kLegendRow;
  }
}

}  // namespace

std::string DrawChart(absl::Span<const ChartPanel> panels, const ChartSize& size) {
  Canvas canvas(size.width, size.height);
  const auto legend = LegendRows(panels.front().lines, size.width - kLeft - kRight);
  const double bottom = size.height - kMargin - kLegendRow * static_cast<double>(legend.size());
  const double panel_width = static_cast<double>(size.width) / static_cast<double>(panels.size());
  for (size_t i = 0; i < panels.size(); ++i) {
    const double left = panel_width * static_cast<double>(i);
    DrawPanel(panels[i], FrameOf(panels[i], left, left + panel_width, bottom), &canvas);
  }
  DrawLegend(legend, {kLeft, bottom + kLegendRow / 2}, &canvas);
  return canvas.EncodePng();
}

}  // namespace craftfleet
