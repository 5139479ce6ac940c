#include "deploy/cli/plot/bar_chart.h"

#include <algorithm>
#include <cmath>

#include <absl/strings/str_format.h>

#include "deploy/cli/plot/axis.h"
#include "deploy/cli/plot/legend.h"
#include "deploy/cli/plot/look.h"

namespace craftfleet {
namespace {

// Pixels.
constexpr double kWidth = 1000;  // of the picture; more with long labels
constexpr double kNarrowestBars = 500;
constexpr double kTop = 46;
constexpr double kBottom = 54;  // the axis' numbers and its label
constexpr double kMargin = 22;
constexpr double kLabelGap = 10;
constexpr double kBar = 13;
constexpr double kBetweenCategories = 11;
constexpr double kNumberSize = 8;
constexpr double kNumberRoom = 46;
constexpr double kPixelsPerTick = 85;

struct Frame {
  double left, right, top, bottom;  // pixels
  Axis axis;
  double At(double value) const { return left + value / axis.high * (right - left); }
};

Frame FrameOf(const BarChart& chart) {
  double labels = 0;
  for (const std::string& category : chart.categories) {
    labels = std::max(labels, Canvas::TextWidth(category, kTextSize));
  }
  double high = 0;
  for (const BarSeries& series : chart.series) {
    for (const std::optional<Bar>& bar : series.bars) {
      if (bar.has_value()) high = std::max(high, bar->value + bar->spread);
    }
  }
  const double category = kBar * static_cast<double>(chart.series.size()) + kBetweenCategories;
  const double left = kMargin + labels + kLabelGap;
  Frame frame = {left,
                 std::max(kWidth - kMargin - kNumberRoom, left + kNarrowestBars),
                 kTop,
                 kTop + category * static_cast<double>(chart.categories.size()),
                 {}};
  frame.axis = RoundAxis(0, high, static_cast<int>((frame.right - frame.left) / kPixelsPerTick));
  return frame;
}

void DrawAxis(const BarChart& chart, const Frame& frame, Canvas* canvas) {
  const double middle = (frame.left + frame.right) / 2;
  canvas->DrawText(chart.title, {middle, frame.top - 18}, TextPlace::kCenter, kTitleSize, kTextColor);
  for (const double tick : frame.axis.ticks) {
    const double x = frame.At(tick);
    canvas->DrawLine({{x, frame.top}, {x, frame.bottom}}, {kGridColor});
    canvas->DrawText(TickText(tick), {x, frame.bottom + 8 + kTextSize}, TextPlace::kCenter, kTextSize, kTextColor);
  }
  canvas->DrawText(chart.label, {middle, frame.bottom + 28 + kTextSize}, TextPlace::kCenter, kTextSize, kTextColor);
}

void DrawBar(const Bar& bar, const Color& color, double top, const Frame& frame, Canvas* canvas) {
  const double end = frame.At(bar.value);
  const double middle = top + kBar / 2;
  canvas->FillRectangle({frame.left, top + 1}, {end, top + kBar - 1}, color);
  double text = end;
  if (bar.spread > 0) {
    const double low = frame.At(std::max(0.0, bar.value - bar.spread));
    const double high = frame.At(bar.value + bar.spread);
    canvas->DrawLine({{low, middle}, {high, middle}}, {kFrameColor, 1.5});
    canvas->DrawLine({{high, middle - 3}, {high, middle + 3}}, {kFrameColor, 1.5});
    canvas->DrawLine({{low, middle - 3}, {low, middle + 3}}, {kFrameColor, 1.5});
    text = high;
  }
  canvas->DrawText(absl::StrFormat("%.1f", bar.value), {text + 5, middle + kNumberSize / 2}, TextPlace::kLeft,
                   kNumberSize, kTextColor);
}

}  // namespace

std::string DrawBars(const BarChart& chart) {
  const Frame frame = FrameOf(chart);
  std::vector<LegendEntry> entries;
  for (const BarSeries& series : chart.series) {
    if (!series.name.empty()) entries.push_back({series.name, {series.color, kBar - 3}});
  }
  const Legend legend(entries, frame.right - frame.left);
  Canvas canvas(static_cast<int>(std::ceil(frame.right + kMargin + kNumberRoom)),
                static_cast<int>(std::ceil(frame.bottom + kBottom + legend.height() + kMargin / 2)));
  DrawAxis(chart, frame, &canvas);
  double top = frame.top + kBetweenCategories / 2;
  for (size_t c = 0; c < chart.categories.size(); ++c) {
    const double middle = top + kBar * static_cast<double>(chart.series.size()) / 2;
    canvas.DrawText(chart.categories[c], {frame.left - kLabelGap, middle + kTextSize / 2}, TextPlace::kRight, kTextSize,
                    kTextColor);
    for (const BarSeries& series : chart.series) {
      if (series.bars[c].has_value()) {
        DrawBar(*series.bars[c], series.color, top, frame, &canvas);
      } else {
        canvas.DrawText(series.missing, {frame.left + 5, top + (kBar + kNumberSize) / 2}, TextPlace::kLeft, kNumberSize,
                        kFrameColor);
      }
      top += kBar;
    }
    top += kBetweenCategories;
  }
  canvas.DrawLine({{frame.left, frame.top}, {frame.left, frame.bottom}, {frame.right, frame.bottom}},
                  {kFrameColor, 1.2});
  legend.Draw({frame.left, frame.bottom + kBottom}, &canvas);
  return canvas.EncodePng();
}

}  // namespace craftfleet
