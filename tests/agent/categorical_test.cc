#include "common/agent/categorical.h"

#include <cmath>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using Logits = std::array<float, kNumActions>;

TEST(Categorical, EqualLogitsAreUniform) {
  Logits logits;
  logits.fill(123.0F);
  const Categorical odds(logits.data());
  EXPECT_NEAR(odds.Entropy(), std::log(17.0), 1e-12);
  for (int i = 0; i < kNumActions; ++i) {
    EXPECT_NEAR(odds.log_probs[i], -std::log(17.0), 1e-12);
    EXPECT_EQ(static_cast<int>(odds.Sample((i + 0.5) / kNumActions)), i);
  }
  EXPECT_EQ(odds.Greedy(), Action::kNoop);
}

TEST(Categorical, SamplesByTheCumulativeDistribution) {
  Logits logits;
  logits.fill(-1000.0F);
  logits[2] = std::log(0.25F);
  logits[16] = std::log(0.75F);
  const Categorical odds(logits.data());
  EXPECT_EQ(static_cast<int>(odds.Sample(0.0)), 2);
  EXPECT_EQ(static_cast<int>(odds.Sample(0.2499)), 2);
  EXPECT_EQ(static_cast<int>(odds.Sample(0.2501)), 16);
  EXPECT_EQ(static_cast<int>(odds.Sample(std::nextafter(1.0, 0.0))), 16);
  EXPECT_EQ(static_cast<int>(odds.Greedy()), 16);
  EXPECT_NEAR(odds.Entropy(), -0.25 * std::log(0.25) - 0.75 * std::log(0.75), 1e-6);
}

TEST(Categorical, HugeLogitsDoNotOverflow) {
  Logits logits;
  logits.fill(-3e38F);
  logits[5] = 3e38F;
  const Categorical odds(logits.data());
  EXPECT_EQ(odds.log_probs[5], 0);
  EXPECT_EQ(odds.Sample(0.5), Action::kDo);
}

}  // namespace
}  // namespace craftfleet
