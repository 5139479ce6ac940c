#include "actor/recording/picture.h"

#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

using Pixel = std::vector<int>;  // red, green, blue

Pixel PixelAt(const std::string& picture, int width, int x, int y) {
  Pixel pixel;
  for (int c = 0; c < 3; ++c) pixel.push_back(static_cast<unsigned char>(picture[3 * (y * width + x) + c]));
  return pixel;
}

std::string Plain(int size, const Pixel& color) {
  std::string picture;
  for (int i = 0; i < size * size; ++i) {
    for (const int c : color) picture.push_back(static_cast<char>(c));
  }
  return picture;
}

TEST(OverlayAttention, LeavesHalfTheGreyWhereNobodyLooksAndLightsTheRest) {
  const std::string overlay = OverlayAttention(Plain(4, {100, 200, 50}), 4, {0, 1, 0.5, 0}, 2);
  EXPECT_EQ(PixelAt(overlay, 4, 0, 0), (Pixel{77, 77, 77})) << "half of 0.3 * 100 + 0.59 * 200 + 0.11 * 50";
  EXPECT_EQ(PixelAt(overlay, 4, 1, 1), (Pixel{77, 77, 77}));
  EXPECT_EQ(PixelAt(overlay, 4, 3, 0), (Pixel{162, 196, 54})) << "0.6 of it and 0.4 of 255, 190, 60";
  EXPECT_EQ(PixelAt(overlay, 4, 0, 2), (Pixel{119, 136, 65})) << "half and half";
  EXPECT_EQ(PixelAt(overlay, 4, 3, 3), (Pixel{77, 77, 77}));
}

// As in a video of 144 pixels of an agent that sees 72, and in one of a size that is no multiple.
TEST(OverlayAttention, IsWhereTheFrameHasIt) {
  std::vector<float> brightness(72 * 72);
  for (int y = 24; y < 36; ++y) {
    for (int x = 8; x < 20; ++x) brightness[y * 72 + x] = 1;
  }
  const auto is_lit = [&](const std::string& overlay, int size, int x, int y) {
    return PixelAt(overlay, size, x, y)[0] > 100;
  };
  for (const int size : {144, 576, 100, 50}) {
    const std::string overlay = OverlayAttention(Plain(size, {0, 0, 0}), size, brightness, 72);
    int lit = 0;
    for (int y = 0; y < size; ++y) {
      for (int x = 0; x < size; ++x) {
        if (!is_lit(overlay, size, x, y)) continue;
        ++lit;
        ASSERT_TRUE(x * 72 / size >= 8 && x * 72 / size < 20 && y * 72 / size >= 24 && y * 72 / size < 36);
      }
    }
    EXPECT_NEAR(lit, 144.0 * size * size / (72 * 72), 2.0 * size / 6) << size;
  }
}

TEST(SideBySide, KeepsRows) {
  const std::string both = SideBySide(Plain(2, {1, 2, 3}), Plain(2, {7, 8, 9}), 2);
  ASSERT_EQ(both.size(), 24);
  for (int y = 0; y < 2; ++y) {
    EXPECT_EQ(PixelAt(both, 4, 1, y), (Pixel{1, 2, 3}));
    EXPECT_EQ(PixelAt(both, 4, 2, y), (Pixel{7, 8, 9}));
  }
}

TEST(WritePng, IsReadBackPixelForPixel) {
  const TempFolder folder;
  const std::string picture = SideBySide(Plain(2, {255, 0, 10}), Plain(2, {20, 30, 255}), 2);
  ASSERT_THAT(WritePng(folder / "a.png", picture, 4, 2), IsOk());
  const cv::Mat read = cv::imread(folder / "a.png");
  ASSERT_EQ(read.cols, 4);
  ASSERT_EQ(read.rows, 2);
  EXPECT_EQ(read.at<cv::Vec3b>(1, 0), (cv::Vec3b{10, 0, 255})) << "blue, green, red";
  EXPECT_EQ(read.at<cv::Vec3b>(0, 3), (cv::Vec3b{255, 30, 20}));
  EXPECT_THAT(WritePng(folder / "none/a.png", picture, 4, 2),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("none/a.png")));
}

}  // namespace
}  // namespace craftfleet
