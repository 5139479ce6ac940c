#include "common/rate_meter.h"

#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"

namespace craftfleet {
namespace {

TEST(RateMeter, CountsWholeSecondsThatLieBehind) {
  FakeClock clock;
  RateMeter meter(&clock);
  meter.Add(30);
  EXPECT_EQ(meter.PerSecond(), 0);
  clock.Advance(absl::Seconds(1));
  meter.Add(1000);  // of the second under way: not yet
  EXPECT_EQ(meter.PerSecond(), 30);
  clock.Advance(absl::Seconds(1));
  EXPECT_EQ(meter.PerSecond(), 515);
}

TEST(RateMeter, ForgetsWhatIsLongAgo) {
  FakeClock clock;
  RateMeter meter(&clock);
  meter.Add(90);
  clock.Advance(absl::Seconds(9));
  EXPECT_EQ(meter.PerSecond(), 10);
  clock.Advance(absl::Seconds(1));
  EXPECT_EQ(meter.PerSecond(), 0);
}

}  // namespace
}  // namespace craftfleet
