#include "common/io/png_encoder.h"

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// Each byte differs from its neighbours in a way that shows a swapped channel, row or column.
std::string Pattern(int width, int height) {
  std::string pixels;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (const int value : {7 * x + y, 251 - 3 * x, 5 * y}) pixels.push_back(static_cast<char>(value));
    }
  }
  return pixels;
}

TEST(EncodePng, AnotherDecoderReadsTheSamePixels) {
  for (const auto& [width, height] : {std::pair(1, 1), std::pair(64, 64), std::pair(301, 17), std::pair(3, 500)}) {
    const std::string pixels = Pattern(width, height);
    const auto png = EncodePng(pixels, width, height);
    ASSERT_THAT(png, IsOk());
    const cv::Mat bgr = cv::imdecode(std::vector<uint8_t>(png->begin(), png->end()), cv::IMREAD_UNCHANGED);
    ASSERT_EQ(bgr.type(), CV_8UC3);
    ASSERT_EQ(bgr.cols, width);
    ASSERT_EQ(bgr.rows, height);
    std::string read;
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const auto& pixel = bgr.at<cv::Vec3b>(y, x);
        for (int c = 2; c >= 0; --c) read.push_back(static_cast<char>(pixel[c]));
      }
    }
    EXPECT_EQ(read, pixels) << width << "x" << height;
  }
}

TEST(EncodePng, RefusesASizeThatIsNotThePictures) {
  EXPECT_THAT(EncodePng("abc", 1, 2).status().message(),
              HasSubstr("picture of 1x2 pixels in 3 bytes, want 1 to 1000000 a side and 3 bytes a pixel"));
  EXPECT_EQ(EncodePng("", 0, 5).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(EncodePng("abc", -1, -1).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(EncodePng(std::string(3000003, ' '), 1000001, 1).status().code(), absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace craftfleet
