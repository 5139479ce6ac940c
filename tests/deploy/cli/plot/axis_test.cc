#include "deploy/cli/plot/axis.h"

#include <cmath>
#include <random>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::Pointwise;

MATCHER(IsClose, "") { return std::abs(std::get<0>(arg) - std::get<1>(arg)) < 1e-12; }

TEST(RoundAxis, TakesTheSmallestRoundStepThatFits) {
  EXPECT_THAT(RoundAxis(0, 300'000, 6).ticks, ElementsAre(0, 50e3, 100e3, 150e3, 200e3, 250e3, 300e3));
  EXPECT_THAT(RoundAxis(0, 300'000, 5).ticks, ElementsAre(0, 100e3, 200e3, 300e3));
  EXPECT_THAT(RoundAxis(0, 7.1, 8).ticks, ElementsAre(0, 1, 2, 3, 4, 5, 6, 7, 8));
  EXPECT_THAT(RoundAxis(0, 7.1, 4).ticks, ElementsAre(0, 2, 4, 6, 8));
  EXPECT_THAT(RoundAxis(0, 7.1, 3).ticks, ElementsAre(0, 2.5, 5, 7.5));
  EXPECT_THAT(RoundAxis(0, 7.1, 2).ticks, ElementsAre(0, 5, 10));
  EXPECT_THAT(RoundAxis(-1, 70, 2).ticks, ElementsAre(-100, 0, 100));
}

TEST(RoundAxis, DoesNotOpenAStepForARoundingError) {
  EXPECT_THAT(RoundAxis(0, 0.1 + 0.2, 3).ticks, Pointwise(IsClose(), {0.0, 0.1, 0.2, 0.3}));
  EXPECT_THAT(RoundAxis(0, 8192, 5).ticks, ElementsAre(0, 2000, 4000, 6000, 8000, 10000));
}

TEST(RoundAxis, EnclosesValuesBelowZero) {
  const Axis axis = RoundAxis(-0.9, 2, 4);
  EXPECT_THAT(axis.ticks, ElementsAre(-1, 0, 1, 2));
  EXPECT_EQ(axis.low, -1);
  EXPECT_EQ(axis.high, 2);
}

TEST(RoundAxis, IsNeverEmpty) {
  for (const double value : {-5.0, 0.0, 0.3, 1e9}) {
    const Axis axis = RoundAxis(value, value, 4);
    EXPECT_LT(axis.low, axis.high) << value;
    EXPECT_LE(axis.low, value);
    EXPECT_GE(axis.high, value);
  }
}

TEST(RoundAxis, EnclosesAnyRangeWithinTheMaximumOfSteps) {
  std::mt19937 random(1);
  for (int i = 0; i < 2000; ++i) {
    const double low = std::uniform_real_distribution<>(-100, 100)(random);
    const double high = low + std::pow(10, std::uniform_real_distribution<>(-3, 7)(random));
    const int most_steps = std::uniform_int_distribution<>(2, 12)(random);
    const Axis axis = RoundAxis(low, high, most_steps);
    const double slack = 1e-6 * (high - low);
    ASSERT_LE(axis.low, low + slack) << low << " " << high;
    ASSERT_GE(axis.high, high - slack) << low << " " << high;
    ASSERT_GE(axis.ticks.size(), 2U);
    ASSERT_LE(axis.ticks.size(), most_steps + 1U);
  }
}

TEST(DataAxis, EndsWhereTheDataEnd) {
  const Axis axis = DataAxis(0, 1'003'520, 6);
  EXPECT_THAT(axis.ticks, ElementsAre(0, 200e3, 400e3, 600e3, 800e3, 1e6));
  EXPECT_EQ(axis.low, 0);
  EXPECT_EQ(axis.high, 1'003'520);
  EXPECT_THAT(DataAxis(0, 300'000, 6).ticks, ElementsAre(0, 50e3, 100e3, 150e3, 200e3, 250e3, 300e3));
  EXPECT_THAT(DataAxis(0, 0.1 + 0.2, 3).ticks, Pointwise(IsClose(), {0.0, 0.1, 0.2, 0.3}));
  EXPECT_LT(DataAxis(0, 0, 4).low, DataAxis(0, 0, 4).high);
}

TEST(TickText, IsShort) {
  EXPECT_EQ(TickText(0), "0");
  EXPECT_EQ(TickText(3 * 0.1), "0.3");
  EXPECT_EQ(TickText(-2.5), "-2.5");
  EXPECT_EQ(TickText(950), "950");
  EXPECT_EQ(TickText(50'000), "50k");
  EXPECT_EQ(TickText(1'500'000), "1.5M");
}

}  // namespace
}  // namespace craftfleet
