#include "envserver/announcer.h"

#include <limits>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

absl::Duration IntervalOf(int lease_ms) {
  v1::AnnounceReply reply;
  reply.set_lease_ms(lease_ms);
  return AnnouncementInterval(reply);
}

TEST(Announcer, AnnouncesEightTimesWithinTheLearnersLease) {
  EXPECT_EQ(IntervalOf(8000), absl::Seconds(1));
  EXPECT_EQ(IntervalOf(2000), absl::Milliseconds(250));
}

TEST(Announcer, NeitherFloodsTheLearnerNorFallsSilentWhateverTheLease) {
  EXPECT_EQ(IntervalOf(800), absl::Milliseconds(100));
  EXPECT_EQ(IntervalOf(799), absl::Milliseconds(100));
  EXPECT_EQ(IntervalOf(0), absl::Milliseconds(100));
  EXPECT_EQ(IntervalOf(std::numeric_limits<int>::min()), absl::Milliseconds(100));
  EXPECT_EQ(IntervalOf(80'000), absl::Seconds(10));
  EXPECT_EQ(IntervalOf(80'001), absl::Seconds(10));
  EXPECT_EQ(IntervalOf(std::numeric_limits<int>::max()), absl::Seconds(10));
}

}  // namespace
}  // namespace craftfleet
