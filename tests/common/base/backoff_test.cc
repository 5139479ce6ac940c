#include "common/base/backoff.h"

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(Backoff, DoublesUpToItsLimitAndRestartsAfterReset) {
  const absl::Duration first = absl::Milliseconds(100);
  const absl::Duration limit = absl::Milliseconds(450);
  Backoff backoff(first, limit);
  for (int round = 0; round < 2; ++round) {
    absl::Duration pause = first;
    for (int i = 0; i < 6; ++i) {
      const absl::Duration next = backoff.Next();
      EXPECT_GE(next, pause / 2);
      EXPECT_LE(next, pause);
      pause = std::min(2 * pause, limit);
    }
    backoff.Reset();
  }
}

TEST(Backoff, TwoInstancesPauseDifferently) {
  Backoff one(absl::Seconds(1), absl::Seconds(8));
  Backoff other(absl::Seconds(1), absl::Seconds(8));
  int same = 0;
  for (int i = 0; i < 8; ++i) same += one.Next() == other.Next() ? 1 : 0;
  EXPECT_LT(same, 8);
}

}  // namespace
}  // namespace craftfleet
