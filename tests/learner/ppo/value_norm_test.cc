#include "learner/ppo/value_norm.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

// Values of 1e6 deviations made a fragment's returns a million times larger than the last ones, again and again: after
// some updates the deviation was 1e32.
TEST(ValueNorm, OutputsAreBoundedByTheValuesThatTheyStandFor) {
  for (const ValueScale& scale : {ValueScale{0, 1}, ValueScale{-3, 0.1}, ValueScale{20, 500}}) {
    const ValueRange range = scale.Outputs();
    EXPECT_NEAR(scale.Denormalise(static_cast<float>(range.low)), -kMaxValue, 0.01);
    EXPECT_NEAR(scale.Denormalise(static_cast<float>(range.high)), kMaxValue, 0.01);
  }
}

TEST(ValueNorm, StatisticsOfImpossibleReturnsAreRefused) {
  ValueNorm norm;
  EXPECT_THAT(norm.Check(), IsOk());
  for (int i = 0; i < 100; ++i) norm.Update({static_cast<float>(kMaxReturn), -3}, 0.9);
  EXPECT_THAT(norm.Check(), IsOk());
  for (const ValueNorm& wrong : {ValueNorm{1e32, 1e64, 1}, ValueNorm{0, 1e12, 1}, ValueNorm{0, -1, 1},
                                 ValueNorm{0, 0, 2}, ValueNorm{5, 5, 0}, ValueNorm{std::nan(""), 0, 1}}) {
    EXPECT_THAT(wrong.Check(),
                StatusIs(absl::StatusCode::kInvalidArgument, testing::HasSubstr("returns within +-1025")))
        << wrong.mean << " " << wrong.mean_square << " " << wrong.weight;
  }
}

TEST(ValueNorm, ValuesMayStartWithAnotherDeviation) {
  EXPECT_EQ(ValueNorm().Scale(0.1).mean, 0);
  EXPECT_EQ(ValueNorm().Scale(0.1).deviation, 0.1);
  ValueNorm norm;
  norm.Update({1, 2, 6}, 0.99);
  EXPECT_EQ(norm.Scale(0.1).deviation, norm.Scale().deviation);
}

TEST(ValueNorm, TheVarianceIsAtLeastAHundredth) {
  ValueNorm norm;
  norm.Update({5, 5, 5}, 0.99);
  EXPECT_NEAR(norm.Scale().mean, 5, 1e-12);
  EXPECT_NEAR(norm.Scale().deviation, 0.1, 1e-12);
}

TEST(ValueNorm, NormalisedValuesComeBack) {
  ValueNorm norm;
  norm.Update({-1, 0.5F, 7}, 0.99);
  const ValueScale scale = norm.Scale();
  EXPECT_NEAR(scale.Denormalise(scale.Normalise(4.25F)), 4.25F, 1e-6);
  EXPECT_NEAR(scale.Normalise(static_cast<float>(scale.mean)), 0, 1e-6);
}

}  // namespace
}  // namespace craftfleet
