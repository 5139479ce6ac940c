#include "deploy/cli/plot/canvas.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "common/base/check.h"
#include "common/io/png_encoder.h"

namespace craftfleet {
namespace {

// The picture is drawn this much larger and scaled down at the end. Otherwise OpenCV's letters, thin polygons, look
// ragged.
constexpr int kScale = 3;
constexpr int kFractionBits = 4;  // of OpenCV's coordinates
constexpr int kFont = cv::FONT_HERSHEY_SIMPLEX;
constexpr double kFontCapitals = 21;  // pixels, at font scale 1

cv::Scalar ToScalar(const Color& color) { return cv::Scalar(color.blue, color.green, color.red); }

cv::Point ToFixed(const Point& point) {
  constexpr double kUnits = kScale * (1 << kFractionBits);
  return {static_cast<int>(std::lround(point.x * kUnits)), static_cast<int>(std::lround(point.y * kUnits))};
}

double FontScale(double size) { return size * kScale / kFontCapitals; }

int FontThickness(double size) { return std::max(1, static_cast<int>(std::lround(size * kScale / 9))); }

// The dashes of the line through `points`.
std::vector<std::vector<Point>> Cut(absl::Span<const Point> points, double dash) {
  std::vector<std::vector<Point>> dashes = {{points.front()}};
  bool inside = true;
  double left = dash;  // of this dash or gap
  for (size_t i = 1; i < points.size(); ++i) {
    Point from = points[i - 1];
    const Point to = points[i];
    double length = std::hypot(to.x - from.x, to.y - from.y);
    while (length > left) {
      from = {from.x + (to.x - from.x) * left / length, from.y + (to.y - from.y) * left / length};
      length -= left;
      left = dash;
      if (inside) {
        dashes.back().push_back(from);
      } else {
        dashes.push_back({from});
      }
      inside = !inside;
    }
    left -= length;
    if (inside) dashes.back().push_back(to);
  }
  return dashes;
}

}  // namespace

Canvas::Canvas(int width, int height) : pixels_(height * kScale, width * kScale, CV_8UC3, cv::Scalar::all(255)) {}

void Canvas::DrawLine(absl::Span<const Point> points, const Stroke& stroke) {
  if (points.empty()) return;
  const std::vector<std::vector<Point>> pieces =
      stroke.dash > 0 ? Cut(points, stroke.dash) : std::vector<std::vector<Point>>{{points.begin(), points.end()}};
  std::vector<std::vector<cv::Point>> lines;
  for (const std::vector<Point>& piece : pieces) {
    std::vector<cv::Point>& line = lines.emplace_back();
    for (const Point& point : piece) line.push_back(ToFixed(point));
  }
  cv::polylines(pixels_, lines, /*isClosed=*/false, ToScalar(stroke.color),
                std::max(1, static_cast<int>(std::lround(stroke.width * kScale))), cv::LINE_AA, kFractionBits);
}

void Canvas::FillPolygon(absl::Span<const Point> points, const Color& color, double opacity) {
  if (points.size() < 3) return;
  std::vector<cv::Point> outline;
  outline.reserve(points.size());
  for (const Point& point : points) outline.push_back(ToFixed(point));
  cv::Mat filled = pixels_.clone();
  cv::fillPoly(filled, std::vector<std::vector<cv::Point>>{outline}, ToScalar(color), cv::LINE_AA, kFractionBits);
  cv::addWeighted(filled, opacity, pixels_, 1 - opacity, 0, pixels_);
}

void Canvas::FillRectangle(const Point& corner, const Point& opposite, const Color& color) {
  const auto pixel = [](double x) { return static_cast<int>(std::lround(x * kScale)); };
  cv::rectangle(pixels_, {pixel(corner.x), pixel(corner.y)}, {pixel(opposite.x) - 1, pixel(opposite.y) - 1},
                ToScalar(color), cv::FILLED);
}

void Canvas::DrawText(const std::string& text, Point at, TextPlace place, double size, const Color& color) {
  if (place == TextPlace::kCenter) at.x -= TextWidth(text, size) / 2;
  if (place == TextPlace::kRight) at.x -= TextWidth(text, size);
  cv::putText(pixels_, text, cv::Point2d(at.x * kScale, at.y * kScale), kFont, FontScale(size), ToScalar(color),
              FontThickness(size), cv::LINE_AA);
}

void Canvas::DrawTextUpwards(const std::string& text, Point at, double size, const Color& color) {
  const int length = static_cast<int>(std::ceil(TextWidth(text, size)));
  const int height = static_cast<int>(std::ceil(2 * size));  // room below the base line and above the capitals
  Canvas level(length, height);
  level.DrawText(text, {0, 1.5 * size}, TextPlace::kLeft, size, color);
  cv::Mat turned;
  cv::rotate(level.pixels_, turned, cv::ROTATE_90_COUNTERCLOCKWISE);
  const cv::Point corner(static_cast<int>(std::lround((at.x - height / 2.0) * kScale)),
                         static_cast<int>(std::lround((at.y - length / 2.0) * kScale)));
  const cv::Rect place = cv::Rect(corner, turned.size()) & cv::Rect(cv::Point(), pixels_.size());
  turned(place - corner).copyTo(pixels_(place));
}

double Canvas::TextWidth(const std::string& text, double size) {
  int base_line = 0;
  return cv::getTextSize(text, kFont, FontScale(size), FontThickness(size), &base_line).width /
         static_cast<double>(kScale);
}

std::string Canvas::EncodePng() const {
  cv::Mat picture;
  cv::resize(pixels_, picture, pixels_.size() / kScale, 0, 0, cv::INTER_AREA);
  cv::cvtColor(picture, picture, cv::COLOR_BGR2RGB);
  CRAFTFLEET_CHECK(picture.isContinuous());
  auto png = craftfleet::EncodePng({reinterpret_cast<const char*>(picture.data), picture.total() * picture.elemSize()},
                                   picture.cols, picture.rows);
  CRAFTFLEET_CHECK(png.ok());
  return *std::move(png);
}

}  // namespace craftfleet
