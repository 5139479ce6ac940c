#include "common/base/keyed_random.h"

#include <array>
#include <cmath>
#include <set>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

// Pearson's statistic of `counts` against equal shares.
template <size_t N>
double ChiSquare(const std::array<int, N>& counts, int total) {
  const double expected = static_cast<double>(total) / N;
  double sum = 0;
  for (const int count : counts) sum += (count - expected) * (count - expected) / expected;
  return sum;
}

TEST(KeyedRandom, KnownValuesDoNotChange) {
  // Resumed runs depend on these values: a change breaks them.
  EXPECT_EQ(KeyedBits(RandomUse::kActionNoise, 0, 0, 0), 0x9AABF63621792331ULL);
  EXPECT_EQ(KeyedBits(RandomUse::kMinibatchOrder, 1, 2, 3), 0xD9AC606C0719FFFFULL);
  EXPECT_EQ(ActionNoise(42, 7, 1000), 0.8688622482361218);
}

TEST(KeyedRandom, DependsOnEveryWordOfTheKey) {
  std::set<uint64_t> seen;
  int keys = 0;
  for (const RandomUse use : {RandomUse::kActionNoise, RandomUse::kMinibatchOrder, RandomUse::kInitialWeights}) {
    for (uint64_t seed = 0; seed < 16; ++seed) {
      for (uint64_t a = 0; a < 16; ++a) {
        for (uint64_t b = 0; b < 16; ++b, ++keys) seen.insert(KeyedBits(use, seed, a, b));
      }
    }
  }
  EXPECT_EQ(seen.size(), keys);
}

TEST(ActionNoise, IsUniformInTheUnitInterval) {
  constexpr int kSteps = 200000;
  std::array<int, 100> counts{};
  for (int step = 0; step < kSteps; ++step) {
    const double noise = ActionNoise(1, step % 16, step / 16);
    ASSERT_GE(noise, 0);
    ASSERT_LT(noise, 1);
    ++counts[static_cast<int>(noise * counts.size())];
  }
  EXPECT_LT(ChiSquare(counts, kSteps), 148.2);  // 99 degrees of freedom: 1 in 1000
}

TEST(ActionNoise, NeighbouringStepsLanesAndSeedsAreIndependent) {
  constexpr int kSteps = 200000;
  std::array<std::array<int, 100>, 3> counts{};
  for (int step = 0; step < kSteps; ++step) {
    const auto bin = [](double noise) { return static_cast<int>(noise * 10); };
    const int own = bin(ActionNoise(1, 3, step));
    ++counts[0][own * 10 + bin(ActionNoise(1, 3, step + 1))];
    ++counts[1][own * 10 + bin(ActionNoise(1, 4, step))];
    ++counts[2][own * 10 + bin(ActionNoise(2, 3, step))];
  }
  for (const auto& pairs : counts) EXPECT_LT(ChiSquare(pairs, kSteps), 148.2);
}

}  // namespace
}  // namespace craftfleet
