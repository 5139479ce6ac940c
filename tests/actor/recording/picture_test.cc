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

TEST(OverlayAttention, GreysPartsWithoutAttentionAndHighlightsTheRest) {
  const std::string overlay = OverlayAttention(Plain(4, {100, 200, 50}), 4, {0, 1, 0.5, 0}, 2);
  EXPECT_EQ(PixelAt(overlay, 4, 0, 0), (Pixel{107, 107, 107})) << "0.7 of 0.3 * 100 + 0.59 * 200 + 0.11 * 50";
  EXPECT_EQ(PixelAt(overlay, 4, 1, 1), (Pixel{107, 107, 107}));
  EXPECT_EQ(PixelAt(overlay, 4, 3, 0), (Pixel{162, 196, 54})) << "0.6 of it and 0.4 of 255, 190, 60";
  EXPECT_EQ(PixelAt(overlay, 4, 0, 2), (Pixel{135, 152, 81})) << "half and half";
  EXPECT_EQ(PixelAt(overlay, 4, 3, 3), (Pixel{107, 107, 107}));
}

// In a picture of 144 pixels for an agent with 72, and in one whose size is not a multiple.
TEST(OverlayAttention, MatchesThePositionInTheFrame) {
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

constexpr PatchGrid kGrid = {4, 2, 2};  // two by two patches of 2 pixels

TEST(LightToHighest, GivesTheHighestWeightFullBrightness) {
  const AttentionLight light = LightToHighest(kGrid, {0.01F, 0.04F, 0, 0.0025F});
  EXPECT_FLOAT_EQ(light.highest, 0.04);
  EXPECT_FLOAT_EQ(light.middle, 0.01) << "its square root is half of the highest weight's";
  EXPECT_FLOAT_EQ(light.brightness[0], 0.5);
  EXPECT_FLOAT_EQ(light.brightness[3], 1);
  EXPECT_FLOAT_EQ(light.brightness[8], 0);
  EXPECT_FLOAT_EQ(light.brightness[15], 0.25);
  EXPECT_EQ(LightToHighest(kGrid, {0, 0, 0, 0}).brightness, std::vector<float>(16));
}

TEST(PercentText, HasTwoDigitsBelow100) {
  EXPECT_EQ(PercentText(0), "0%");
  EXPECT_EQ(PercentText(0.00052), "0.052%");
  EXPECT_EQ(PercentText(0.0996), "10%");
  EXPECT_EQ(PercentText(0.124), "12%");
  EXPECT_EQ(PercentText(0.995), "100%");
  EXPECT_EQ(PercentText(1), "100%");
  EXPECT_EQ(PercentText(1.9), "190%");
}

TEST(BesideOverlay, HasAColourBarBelowThatGetsBrighterToTheRight) {
  for (const int size : {64, 288}) {
    const std::string whole = BesideOverlay(Plain(size, {1, 2, 3}), Plain(size, {7, 8, 9}), size, {{}, 0.01, 0.04});
    EXPECT_EQ(ScaleHeight(size) % 2, 0) << "as videos require";
    ASSERT_EQ(whole.size(), size_t{6} * size * (size + ScaleHeight(size)));
    for (const int y : {0, size - 1}) {
      EXPECT_EQ(PixelAt(whole, 2 * size, size - 1, y), (Pixel{1, 2, 3}));
      EXPECT_EQ(PixelAt(whole, 2 * size, size, y), (Pixel{7, 8, 9}));
    }
    const int bar = size + ScaleHeight(size) / 4;
    const int margin = ScaleHeight(size) / 4;
    EXPECT_EQ(PixelAt(whole, 2 * size, size + margin, bar), (Pixel{90, 90, 90})) << "0.7 of the bar's grey";
    EXPECT_EQ(PixelAt(whole, 2 * size, 2 * size - margin - 1, bar), (Pixel{179, 153, 101})) << "full highlight";
    EXPECT_EQ(PixelAt(whole, 2 * size, 0, bar), (Pixel{0, 0, 0}));
    int red = 0;
    for (int x = size + margin; x < 2 * size - margin; ++x) {
      EXPECT_GE(PixelAt(whole, 2 * size, x, bar)[0], red);
      red = PixelAt(whole, 2 * size, x, bar)[0];
    }
  }
}

TEST(WritePng, IsReadBackPixelForPixel) {
  const TempFolder folder;
  const std::string row("\xff\0\x0a\xff\0\x0a\x14\x1e\xff\x14\x1e\xff", 12);
  const std::string picture = row + row;
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
