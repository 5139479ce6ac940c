#include "deploy/cli/plot/canvas.h"

#include <gtest/gtest.h>

#include "tests/deploy/cli/plot/picture.h"

namespace craftfleet {
namespace {

constexpr Color kWhite = {255, 255, 255};
constexpr Color kBlue = {0, 114, 178};

TEST(Canvas, StartsWhiteInTheGivenSize) {
  const Picture picture(Canvas(120, 70).EncodePng());
  EXPECT_EQ(picture.width(), 120);
  EXPECT_EQ(picture.height(), 70);
  EXPECT_EQ(picture.Count(kWhite), 120 * 70);
}

TEST(Canvas, DrawsALineWhereItIsInItsColour) {
  Canvas canvas(100, 100);
  canvas.DrawLine({{10, 50}, {60, 50}, {60, 90}}, {kBlue, 3});
  const Picture picture(canvas.EncodePng());
  for (int x = 10; x < 60; ++x) EXPECT_TRUE(picture.Is(x, 50, kBlue)) << x;
  for (int y = 50; y < 90; ++y) EXPECT_TRUE(picture.Is(60, y, kBlue)) << y;
  EXPECT_TRUE(picture.Is(30, 47, kWhite));
  EXPECT_TRUE(picture.Is(30, 54, kWhite));
  EXPECT_TRUE(picture.Is(65, 50, kWhite));
}

TEST(Canvas, DashesAreAsLongAsTheGapsAroundACornerToo) {
  Canvas canvas(100, 100);
  canvas.DrawLine({{5, 50}, {30, 50}, {95, 50}}, {kBlue, 3, 10});
  const Picture picture(canvas.EncodePng());
  for (const int dash : {10, 30, 50, 70, 90}) EXPECT_TRUE(picture.Is(dash, 50, kBlue)) << dash;
  for (const int gap : {20, 40, 60, 80}) EXPECT_TRUE(picture.Is(gap, 50, kWhite)) << gap;
}

TEST(Canvas, FillsRectanglesToThePixel) {
  Canvas canvas(100, 100);
  canvas.FillRectangle({10, 20}, {30, 50}, kBlue);
  const Picture picture(canvas.EncodePng());
  EXPECT_EQ(picture.Count(kBlue), 20 * 30);
  EXPECT_TRUE(picture.Is(10, 20, kBlue));
  EXPECT_TRUE(picture.Is(29, 49, kBlue));
  EXPECT_TRUE(picture.Is(30, 50, kWhite));
}

TEST(Canvas, BlendsPolygonsWithTheirBackground) {
  Canvas canvas(100, 100);
  canvas.FillPolygon({{10, 10}, {90, 10}, {90, 90}, {10, 90}}, kBlue);
  canvas.FillPolygon({{50, 0}, {100, 0}, {100, 100}, {50, 100}}, kWhite, 0.5);
  const Picture picture(canvas.EncodePng());
  EXPECT_TRUE(picture.Is(30, 50, kBlue));
  EXPECT_TRUE(picture.Is(70, 50, {127, 184, 216}));
  EXPECT_TRUE(picture.Is(95, 50, kWhite));
}

TEST(Canvas, PutsTextLeftOfOrAroundAPoint) {
  Canvas canvas(200, 100);
  canvas.DrawText("wood", {100, 30}, TextPlace::kRight, 12, kBlue);
  canvas.DrawText("wood", {100, 60}, TextPlace::kLeft, 12, kBlue);
  canvas.DrawText("wood", {100, 90}, TextPlace::kCenter, 12, kBlue);
  const Picture picture(canvas.EncodePng());
  const auto ink = [&](int x, int y) { return 100 * 20 - picture.Count(cv::Rect(x, y, 100, 20), kWhite); };
  EXPECT_GT(ink(0, 15), 50);
  EXPECT_EQ(ink(101, 15), 0);
  EXPECT_EQ(ink(0, 45), 0);
  EXPECT_GT(ink(100, 45), 50);
  EXPECT_GT(ink(0, 75), 25);
  EXPECT_GT(ink(100, 75), 25);
}

TEST(Canvas, TurnsTextAroundItsMiddle) {
  Canvas canvas(100, 200);
  canvas.DrawTextUpwards("achievements", {50, 100}, 12, kBlue);
  const Picture picture(canvas.EncodePng());
  const auto ink = [&](const cv::Rect& area) { return area.area() - picture.Count(area, kWhite); };
  EXPECT_GT(ink({40, 0, 20, 100}), 100);
  EXPECT_GT(ink({40, 100, 20, 100}), 100);
  EXPECT_EQ(ink({0, 0, 35, 200}), 0);
  EXPECT_EQ(ink({65, 0, 35, 200}), 0);
}

TEST(Canvas, ClipsDrawingsToThePicture) {
  Canvas canvas(50, 50);
  canvas.DrawLine({{-100, 25}, {150, 25}}, {kBlue, 3});
  canvas.DrawText("outside", {40, 60}, TextPlace::kLeft, 12, kBlue);
  canvas.DrawTextUpwards("outside", {0, 0}, 12, kBlue);
  EXPECT_TRUE(Picture(canvas.EncodePng()).Is(25, 25, kBlue));
}

TEST(Canvas, WiderTextIsWider) {
  EXPECT_GT(Canvas::TextWidth("reward", 12), 0);
  EXPECT_GT(Canvas::TextWidth("rewards", 12), Canvas::TextWidth("reward", 12));
  EXPECT_NEAR(Canvas::TextWidth("reward", 24), 2 * Canvas::TextWidth("reward", 12), 3);
}

}  // namespace
}  // namespace craftfleet
