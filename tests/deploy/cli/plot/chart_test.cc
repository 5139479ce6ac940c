#include "deploy/cli/plot/chart.h"

#include <utility>

#include <gtest/gtest.h>

#include "tests/deploy/cli/plot/picture.h"

namespace craftfleet {
namespace {

constexpr Color kBlue = {0, 114, 178};
constexpr Color kRed = {213, 94, 0};

ChartLine Line(const std::string& name, const Color& color, std::vector<Point> points) {
  return {name, {color, 3}, std::move(points), {}};
}

// The first row, from above, in which at least `count` pixels of `area` have that colour; -1: none.
int RowOf(const Picture& picture, const cv::Rect& area, const Color& color, int count) {
  for (int y = area.y; y < area.y + area.height; ++y) {
    if (picture.Count(cv::Rect(area.x, y, area.width, 1), color) >= count) return y;
  }
  return -1;
}

TEST(DrawChart, HasTheSizeAskedForAndTheLinesOfEachPanelInIt) {
  const std::vector<ChartPanel> panels = {
      {"left", "x", "y", {Line("blue", kBlue, {{0, 5}, {100, 5}})}},
      {"right", "x", "y", {Line("red", kRed, {{0, 2}, {100, 2}})}},
  };
  const Picture picture(DrawChart(panels, {1000, 400}));
  ASSERT_EQ(picture.width(), 1000);
  ASSERT_EQ(picture.height(), 400);
  const cv::Rect left(0, 0, 500, 330);
  const cv::Rect right(500, 0, 500, 330);
  EXPECT_NE(RowOf(picture, left, kBlue, 380), -1);
  EXPECT_EQ(picture.Count(left, kRed), 0);
  EXPECT_NE(RowOf(picture, right, kRed, 380), -1);
  EXPECT_EQ(picture.Count(right, kBlue), 0);
}

TEST(DrawChart, HigherValuesAreDrawnHigherOnACommonScale) {
  const std::vector<ChartPanel> panels = {
      {"",
       "",
       "",
       {Line("5", kBlue, {{0, 5}, {100, 5}}), Line("10", kRed, {{0, 10}, {100, 10}}),
        Line("0", {0, 158, 115}, {{0, 0}, {100, 0}})}}};
  const Picture picture(DrawChart(panels, {600, 400}));
  const cv::Rect above_legend(0, 0, 600, 340);
  const int five = RowOf(picture, above_legend, kBlue, 400);
  const int ten = RowOf(picture, above_legend, kRed, 400);
  const int zero = RowOf(picture, above_legend, {0, 158, 115}, 400);
  ASSERT_GT(ten, 0);
  EXPECT_NEAR(five - ten, zero - five, 2);
  EXPECT_GT(five - ten, 80);
}

TEST(DrawChart, TheXAxisEndsWhereTheDataEnd) {
  // A rounded axis would end at 200 and leave the right half of the panel empty.
  const Picture picture(DrawChart({{"", "", "", {Line("blue", kBlue, {{0, 5}, {110, 5}})}}}, {600, 400}));
  const cv::Rect last_pixels(560, 0, 10, 340);  // the panel ends at 570
  EXPECT_GT(picture.Count(last_pixels, kBlue), 0);
}

TEST(DrawChart, NamesEachLineOnceInALegendThatWraps) {
  std::vector<ChartLine> lines(6, Line("a line with a rather long name", kBlue, {{0, 0}, {1, 1}}));
  lines.push_back(Line("red", kRed, {{0, 0}, {1, 1}}));
  const Picture picture(DrawChart({{"", "", "", lines}, {"", "", "", lines}}, {800, 500}));
  // Three rows of up to three names: strokes of seven lines, 34 pixels long.
  const cv::Rect legend(0, 400, 800, 100);
  EXPECT_NEAR(picture.Count(legend, kBlue), 6 * 34 * 3, 6 * 34);
  EXPECT_NEAR(picture.Count(legend, kRed), 34 * 3, 34);
}

TEST(DrawChart, TheFirstLineIsOnTop) {
  const std::vector<ChartPanel> panels = {
      {"", "", "", {Line("over", kBlue, {{0, 5}, {100, 5}}), Line("under", kRed, {{0, 5}, {100, 5}})}}};
  const Picture picture(DrawChart(panels, {600, 400}));
  const cv::Rect above_legend(0, 0, 600, 340);
  EXPECT_GT(picture.Count(above_legend, kBlue), 1000);
  EXPECT_EQ(picture.Count(above_legend, kRed), 0);
}

TEST(DrawChart, ASinglePointIsEnough) {
  const std::vector<ChartPanel> panels = {{"", "", "", {Line("one", kBlue, {{7, 3}})}}};
  EXPECT_GT(Picture(DrawChart(panels, {})).Count(kBlue), 0);
}

TEST(DrawChart, ABandIsShadedBetweenItsEdges) {
  ChartLine line = Line("a", kBlue, {{0, 5}, {10, 5}});
  const Picture plain(DrawChart({{"t", "x", "y", {line}}}, {600, 400}));
  line.band = {{0, 4, 6}, {10, 4, 6}};
  const Picture shaded(DrawChart({{"t", "x", "y", {line}}}, {600, 400}));
  constexpr Color kShade = {209, 230, 241};  // blue over white at 18 %
  EXPECT_LT(plain.Count(kShade), 500);
  EXPECT_GT(shaded.Count(kShade), 5000);
}

TEST(DrawChart, ALineWithoutANameIsNotInTheLegend) {
  const ChartLine named = Line("a", kBlue, {{0, 5}, {10, 5}});
  ChartLine unnamed = Line("", kRed, {{0, 1}, {10, 1}});
  const Picture picture(DrawChart({{"t", "x", "y", {named, unnamed}}}, {600, 400}));
  EXPECT_EQ(picture.Count(cv::Rect(0, 350, 600, 50), kRed), 0);
  EXPECT_GT(picture.Count(cv::Rect(0, 350, 600, 50), kBlue), 50);
}

}  // namespace
}  // namespace craftfleet
