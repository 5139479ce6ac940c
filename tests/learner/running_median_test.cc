#include "learner/running_median.h"

#include <algorithm>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(RunningMedian, IsThatOfTheSortedValues) {
  std::mt19937 random(1);
  for (int round = 0; round < 20; ++round) {
    RunningMedian median;
    EXPECT_EQ(median.Get(), std::nullopt);
    std::vector<absl::Duration> values;
    for (int i = 0; i < 200; ++i) {
      values.push_back(absl::Milliseconds(random() % (1 + round * 20)));
      median.Add(values.back());
      std::sort(values.begin(), values.end());
      ASSERT_EQ(median.Get(), values[values.size() / 2]);
    }
    median.Clear();
    EXPECT_EQ(median.Get(), std::nullopt);
  }
}

}  // namespace
}  // namespace craftfleet
