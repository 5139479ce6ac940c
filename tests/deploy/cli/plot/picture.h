// Reads a drawn picture back.

#ifndef CRAFTFLEET_TESTS_DEPLOY_CLI_PLOT_PICTURE_H_
#define CRAFTFLEET_TESTS_DEPLOY_CLI_PLOT_PICTURE_H_

#include <cstdlib>
#include <string>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "deploy/cli/plot/canvas.h"

namespace craftfleet {

class Picture {
 public:
  explicit Picture(const std::string& png)
      : pixels_(cv::imdecode(std::vector<uint8_t>(png.begin(), png.end()), cv::IMREAD_COLOR)) {}

  int width() const { return pixels_.cols; }
  int height() const { return pixels_.rows; }

  // Whether the pixel is nearly of that colour: the edges of lines and letters are blends.
  bool Is(int x, int y, const Color& color) const {
    const auto& pixel = pixels_.at<cv::Vec3b>(y, x);
    return std::abs(pixel[2] - color.red) < 12 && std::abs(pixel[1] - color.green) < 12 &&
           std::abs(pixel[0] - color.blue) < 12;
  }
  int Count(const cv::Rect& area, const Color& color) const {
    int count = 0;
    for (int y = area.y; y < area.y + area.height; ++y) {
      for (int x = area.x; x < area.x + area.width; ++x) count += Is(x, y, color) ? 1 : 0;
    }
    return count;
  }
  int Count(const Color& color) const { return Count(cv::Rect(0, 0, width(), height()), color); }

 private:
  cv::Mat pixels_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_DEPLOY_CLI_PLOT_PICTURE_H_
