#include "deploy/cli/plot/heatmap.h"

#include <gtest/gtest.h>

#include "tests/deploy/cli/plot/picture.h"

namespace craftfleet {
namespace {

constexpr Color kDark = {68, 1, 84};
constexpr Color kYellow = {253, 231, 37};
constexpr Color kGrey = {236, 236, 236};

double Lightness(const Color& color) { return 0.2126 * color.red + 0.7152 * color.green + 0.0722 * color.blue; }

Heatmap SampleMap() { return {"title", {"a", "b"}, {"x", "y"}, {{1.0, 2.0}, {3.0, std::nullopt}}}; }

TEST(HeatColor, GoesFromDarkToYellowEverLighter) {
  EXPECT_EQ(HeatColor(0).red, kDark.red);
  EXPECT_EQ(HeatColor(1).green, kYellow.green);
  EXPECT_EQ(HeatColor(-1).blue, kDark.blue);
  EXPECT_EQ(HeatColor(2).red, kYellow.red);
  for (int i = 1; i <= 100; ++i) EXPECT_GT(Lightness(HeatColor(i / 100.0)), Lightness(HeatColor((i - 1) / 100.0))) << i;
}

// A cell is 54 x 26 pixels less its text.
TEST(DrawHeatmaps, ColoursCellsByTheirValueAndLeavesMissingOnesGrey) {
  const Picture picture(DrawHeatmaps({SampleMap()}, 1));
  EXPECT_GT(picture.Count(kDark), 800);
  EXPECT_GT(picture.Count(kYellow), 800);
  EXPECT_GT(picture.Count(HeatColor(0.5)), 800);
  EXPECT_GT(picture.Count(kGrey), 800);
  EXPECT_LT(picture.Count(kGrey), 54 * 26);
}

TEST(DrawHeatmaps, MapsShareOneScale) {
  Heatmap other = SampleMap();
  other.values = {{3.0, 3.0}, {3.0, 5.0}};
  const Picture picture(DrawHeatmaps({SampleMap(), other}, 2));
  EXPECT_GT(picture.Count(HeatColor(0.5)), 4 * 800);  // the 3 of either
  EXPECT_LT(picture.Count(kYellow), 2 * 54 * 26);
}

TEST(DrawHeatmaps, HaveTheRequestedNumberPerRow) {
  const std::vector<Heatmap> maps(3, SampleMap());
  const Picture beside(DrawHeatmaps(maps, 3));
  const Picture below(DrawHeatmaps(maps, 1));
  EXPECT_GT(beside.width(), 2 * below.width());
  EXPECT_GT(below.height(), 2 * beside.height() - 100);
}

TEST(DrawHeatmaps, WithoutAnyValueAllIsGrey) {
  const Picture picture(DrawHeatmaps({{"t", {"a"}, {"x"}, {{std::nullopt}}}}, 2));
  EXPECT_GT(picture.Count(kGrey), 800);
}

TEST(DrawHeatmaps, EqualValuesHaveTheMiddleColour) {
  const Picture picture(DrawHeatmaps({{"t", {"a"}, {"x", "y"}, {{2.0, 2.0}}}}, 1));
  EXPECT_GT(picture.Count(HeatColor(0.5)), 2 * 800);
}

}  // namespace
}  // namespace craftfleet
