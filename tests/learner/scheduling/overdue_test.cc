#include "learner/scheduling/overdue.h"

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(Overdue, TheLimitIsSeveralTimesTheMedianAndAtLeastSomeSeconds) {
  Overdue overdue(absl::Seconds(3), absl::Seconds(20));
  EXPECT_EQ(overdue.Limit(), absl::Seconds(20)) << "there are no results";
  overdue.Add(absl::Milliseconds(10));
  EXPECT_EQ(overdue.Limit(), absl::Seconds(3));
  overdue.Add(absl::Seconds(2));
  overdue.Add(absl::Seconds(5));
  EXPECT_EQ(overdue.Limit(), absl::Seconds(8));
}

TEST(Overdue, FewLateResultsDoNotStretchTheLimit) {
  Overdue overdue(absl::Seconds(1), absl::Seconds(20));
  for (int i = 0; i < 60; ++i) overdue.Add(absl::Seconds(1));
  for (int i = 0; i < 40; ++i) overdue.Add(absl::Hours(1));
  EXPECT_EQ(overdue.Limit(), absl::Seconds(4));
}

TEST(Overdue, TheLimitFollowsResultsThatTakeLonger) {
  Overdue overdue(absl::Seconds(1), absl::Seconds(20));
  for (int i = 0; i < 1000; ++i) overdue.Add(absl::Seconds(1));
  for (int i = 0; i < 60; ++i) overdue.Add(absl::Minutes(1));
  EXPECT_EQ(overdue.Limit(), absl::Minutes(4));
}

}  // namespace
}  // namespace craftfleet
