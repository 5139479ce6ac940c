#include "envserver/render/image.h"

#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;

constexpr Pixel Rgba(int red, int green, int blue, int alpha) {
  return static_cast<Pixel>(red) | green << 8 | blue << 16 | static_cast<Pixel>(alpha) << 24;
}

// Resizing by the accumulated position: RULES.md, section 12.
TEST(NearestIndices, MatchTheOriginal) {
  EXPECT_THAT(NearestIndices(16, 7), ElementsAre(1, 3, 5, 7, 10, 12, 14));
  EXPECT_THAT(NearestIndices(16, 4), ElementsAre(2, 6, 10, 14));
}

TEST(Resize, SelectsColumnsAndRowsIndependently) {
  Texture texture;
  for (int y = 0; y < kTextureSize; ++y) {
    for (int x = 0; x < kTextureSize; ++x) texture.pixels[y * kTextureSize + x] = 100 * y + x;
  }
  const Image image = Resize(texture, 4, 7);
  EXPECT_EQ(image.width, 4);
  EXPECT_EQ(image.height, 7);
  EXPECT_EQ(image.pixels.size(), 28u);
  EXPECT_EQ(image.at(1, 0), 106u);   // column 6, row 1
  EXPECT_EQ(image.at(3, 4), 1014u);  // column 14, row 10
}

TEST(Blend, FullAlphaShowsTheTextureAndZeroAlphaTheCanvas) {
  for (int value = 0; value < 256; ++value) {
    const Pixel under = Rgba(255 - value, value, 7, 255);
    std::vector<Pixel> canvas = {under, under};
    const std::vector<Pixel> over = {Rgba(value, 3, 255 - value, 255), Rgba(value, 3, 255 - value, 0)};
    Blend(over, absl::MakeSpan(canvas));
    EXPECT_EQ(canvas[0], Rgba(value, 3, 255 - value, 0));
    EXPECT_EQ(canvas[1], Rgba(255 - value, value, 7, 0));
  }
}

// Each operation rounds to float and the last one truncates: 255 * (a t + (1 - a) c) with a = 128 / 255.
TEST(Blend, PartialAlphaMixesInFloats) {
  for (const int alpha : {1, 51, 128, 254}) {
    for (int value = 0; value < 256; ++value) {
      std::vector<Pixel> canvas = {Rgba(value, 200, 0, 0)};
      Blend(std::vector<Pixel>{Rgba(100, value, 255, alpha)}, absl::MakeSpan(canvas));
      const auto expected = [&](int over, int under) {
        const float a = alpha / 255.0f;
        const float top = a * (over / 255.0f);
        const float rest = (1.0f - a) * (under / 255.0f);
        const float sum = top + rest;
        return static_cast<int>(255.0f * sum);
      };
      EXPECT_EQ(canvas[0], Rgba(expected(100, value), expected(value, 200), expected(255, 0), 0)) << alpha;
    }
  }
}

}  // namespace
}  // namespace craftfleet
