#include "deploy/cli/screen/view_picture.h"

#include <algorithm>
#include <cmath>

#include <absl/strings/str_format.h>
#include <opencv2/imgproc.hpp>

namespace craftfleet {
namespace {

constexpr int kLines = 28;       // for which there is always room
constexpr int kTextWidth = 330;  // pixels: kTextColumns characters
constexpr int kLineHeight = 19;  // pixels
constexpr int kMargin = 14;      // pixels, around the text
constexpr int kBarLeft = 170;    // pixels, from the left end of the text
constexpr int kBarWidth = 90;    // pixels
constexpr int kBarHeight = 11;   // pixels
constexpr double kTextScale = 0.47;

cv::Scalar ColorOf(TextLine::Style style) {  // blue, green, red
  switch (style) {
    case TextLine::Style::kPlain:
      return {210, 210, 210};
    case TextLine::Style::kTitle:
      return {255, 255, 255};
    case TextLine::Style::kGood:
      return {120, 220, 120};
    case TextLine::Style::kBad:
      return {110, 110, 255};
  }
  return {};
}

// Draws a bar and its percentage, with the baseline of the text at `y` and its left end at `x`.
void DrawBar(double part, const cv::Scalar& color, int x, int y, cv::Mat* canvas) {
  const cv::Rect frame(x + kBarLeft, y - kBarHeight + 1, kBarWidth, kBarHeight);
  cv::rectangle(*canvas, frame, cv::Scalar::all(60), cv::FILLED);
  cv::rectangle(*canvas, {frame.x, frame.y, static_cast<int>(std::lround(part * kBarWidth)), kBarHeight}, color,
                cv::FILLED);
  cv::putText(*canvas, absl::StrFormat("%.0f%%", 100 * part), {x + kBarLeft + kBarWidth + 8, y},
              cv::FONT_HERSHEY_SIMPLEX, kTextScale, color, 1, cv::LINE_AA);
}

int Even(int size) { return (size + 1) / 2 * 2; }

}  // namespace

cv::Mat DrawView(const View& view, const PictureRoom& room) {
  cv::Mat canvas(Even(std::max(room.height, 2 * kMargin + kLines * kLineHeight)), Even(room.width + kTextWidth),
                 CV_8UC3, cv::Scalar(24, 24, 24));
  const cv::Mat rgb(view.height, view.width, CV_8UC3, const_cast<char*>(view.picture.data()));
  const cv::Rect shown(0, 0, std::min(view.width, room.width), std::min(view.height, canvas.rows));
  cv::Mat bgr;
  cv::cvtColor(rgb(shown), bgr, cv::COLOR_RGB2BGR);
  bgr.copyTo(canvas(shown));
  int y = kMargin + kLineHeight / 2;
  for (const TextLine& line : view.lines) {
    cv::putText(canvas, line.text, {room.width + kMargin, y}, cv::FONT_HERSHEY_SIMPLEX, kTextScale, ColorOf(line.style),
                1, cv::LINE_AA);
    if (line.bar != TextLine::kNoBar) DrawBar(line.bar, ColorOf(line.style), room.width + kMargin, y, &canvas);
    y += kLineHeight;
  }
  return canvas;
}

}  // namespace craftfleet
