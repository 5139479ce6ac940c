#include "deploy/cli/plot/bar_chart.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "tests/deploy/cli/plot/picture.h"

namespace craftfleet {
namespace {

constexpr Color kBlue = {0, 114, 178};
constexpr Color kRed = {213, 94, 0};

// How many pixels of the row that has the most of that colour have it.
int LongestRow(const Picture& picture, const Color& color) {
  int longest = 0;
  for (int y = 0; y < picture.height(); ++y) {
    longest = std::max(longest, picture.Count(cv::Rect(0, y, picture.width(), 1), color));
  }
  return longest;
}

TEST(DrawBars, BarsAreAsLongAsTheirValues) {
  const Picture picture(
      DrawBars({"t", "l", {"a"}, {{"ours", kBlue, {Bar{8, 0}}, ""}, {"paper", kRed, {Bar{4, 0}}, ""}}}));
  EXPECT_NEAR(LongestRow(picture, kBlue), 2 * LongestRow(picture, kRed), 6);
}

TEST(DrawBars, AMissingBarLeavesItsPlaceEmpty) {
  const auto draw = [](std::optional<Bar> second) {
    return Picture(DrawBars({"t", "l", {"a", "b"}, {{"ours", kBlue, {Bar{8, 0}, second}, "no run"}}}));
  };
  EXPECT_EQ(draw(std::nullopt).height(), draw(Bar{8, 0}).height());
  EXPECT_GT(draw(Bar{8, 0}).Count(kBlue), 1.8 * draw(std::nullopt).Count(kBlue) - 1000);
  EXPECT_LT(draw(std::nullopt).Count(kBlue), 0.7 * draw(Bar{8, 0}).Count(kBlue));
}

TEST(DrawBars, WhiskersReachAsFarAsTheSpread) {
  constexpr Color kWhisker = {130, 130, 130};
  const auto draw = [](double spread) {
    return Picture(DrawBars({"t", "l", {"a"}, {{"ours", kBlue, {Bar{5, spread}}, ""}}}));
  };
  EXPECT_GT(draw(2).Count(kWhisker), draw(0).Count(kWhisker) + 100);
}

TEST(DrawBars, GrowsWithCategoriesAndSeries) {
  const std::vector<std::optional<Bar>> bars(3, Bar{1, 0});
  const BarSeries series = {"s", kBlue, bars, ""};
  const Picture one(DrawBars({"t", "l", {"a", "b", "c"}, {series}}));
  const Picture three(DrawBars({"t", "l", {"a", "b", "c"}, {series, series, series}}));
  EXPECT_EQ(three.height() - one.height(), 3 * 2 * 13);
}

}  // namespace
}  // namespace craftfleet
