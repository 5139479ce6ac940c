#include "learner/ppo/minibatches.h"

#include <algorithm>
#include <array>
#include <numeric>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(MinibatchOrder, IsAPermutation) {
  for (const int count : {0, 1, 2, 4096}) {
    std::vector<int> order = MinibatchOrder(1, 2, 3, count);
    std::vector<int> expected(count);
    std::iota(expected.begin(), expected.end(), 0);
    std::sort(order.begin(), order.end());
    EXPECT_EQ(order, expected);
  }
}

TEST(MinibatchOrder, FollowsFromSeedIterationAndEpoch) {
  const std::vector<int> order = MinibatchOrder(1, 2, 3, 4096);
  EXPECT_EQ(MinibatchOrder(1, 2, 3, 4096), order);
  EXPECT_NE(MinibatchOrder(2, 2, 3, 4096), order);
  EXPECT_NE(MinibatchOrder(1, 3, 3, 4096), order);
  EXPECT_NE(MinibatchOrder(1, 2, 4, 4096), order);
}

TEST(MinibatchOrder, EveryOrderIsEquallyLikely) {
  std::array<int, 64> counts{};  // by the order's digits, base 4
  constexpr int kOrders = 24000;
  for (int iteration = 0; iteration < kOrders; ++iteration) {
    const std::vector<int> order = MinibatchOrder(3, iteration, 0, 4);
    ++counts[order[0] * 16 + order[1] * 4 + order[2]];
  }
  double chi_square = 0;
  int orders = 0;
  for (const int count : counts) {
    if (count == 0) continue;
    ++orders;
    chi_square += (count - 1000.0) * (count - 1000.0) / 1000.0;
  }
  EXPECT_EQ(orders, 24);
  EXPECT_LT(chi_square, 49.7);  // 23 degrees of freedom: 1 in 1000
}

}  // namespace
}  // namespace craftfleet
