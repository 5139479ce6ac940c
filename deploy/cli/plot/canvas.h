// A white picture to draw smooth lines and text on.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLOT_CANVAS_H_
#define CRAFTFLEET_DEPLOY_CLI_PLOT_CANVAS_H_

#include <cstdint>
#include <string>

#include <absl/types/span.h>
#include <opencv2/core/mat.hpp>

namespace craftfleet {

struct Color {
  uint8_t red = 0;
  uint8_t green = 0;
  uint8_t blue = 0;
};

struct Point {
  double x = 0;
  double y = 0;
};

// How a line looks; lengths in pixels.
struct Stroke {
  Color color;
  double width = 1;
  double dash = 0;  // length of a dash and of the gap after it; 0: a solid line
};

enum class TextPlace { kLeft, kCenter, kRight };  // of the point within the text

// Coordinates are pixels from the upper left corner, y downwards. Drawings are clipped to the picture. Owned by one
// thread.
class Canvas {
 public:
  // 1..10000 each.
  Canvas(int width, int height);

  // Through `points`, in order.
  void DrawLine(absl::Span<const Point> points, const Stroke& stroke);
  // Three points or more, else nothing; `opacity` 0..1.
  void FillPolygon(absl::Span<const Point> points, const Color& color, double opacity = 1);
  void FillRectangle(const Point& corner, const Point& opposite, const Color& color);
  // `at` is on the text's base line; `size` is the height of its capitals. ASCII only.
  void DrawText(const std::string& text, Point at, TextPlace place, double size, const Color& color);
  // The same, rotated by 90 degrees to read upwards, and centred on `at`.
  void DrawTextUpwards(const std::string& text, Point at, double size, const Color& color);
  static double TextWidth(const std::string& text, double size);

  // The picture as a PNG file.
  std::string EncodePng() const;

 private:
  cv::Mat pixels_;  // BGR, finer than the picture
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLOT_CANVAS_H_
