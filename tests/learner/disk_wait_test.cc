#include "learner/disk_wait.h"

#include <algorithm>
#include <string>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

class DiskWaitTest : public testing::Test {
 protected:
  FakeClock clock_;
  StopFlag stop_;
  DiskWait disk_{&stop_, &clock_, absl::ZeroDuration()};
};

TEST_F(DiskWaitTest, ReportsEveryFifteenSeconds) {
  testing::internal::CaptureStderr();
  disk_.Report("stats.jsonl is full");
  disk_.Report("a second one");
  clock_.Advance(DiskWait::kReportEvery - absl::Seconds(1));
  disk_.Report("a third one");
  clock_.Advance(absl::Seconds(1));
  disk_.Report("it is still full");
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(log, HasSubstr("error: stats.jsonl is full; free space on that disk"));
  EXPECT_THAT(log, HasSubstr("error: it is still full; free space"));
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 2) << log;
}

TEST_F(DiskWaitTest, WaitsUntilTrainingIsStopped) {
  testing::internal::CaptureStderr();
  EXPECT_TRUE(disk_.Wait("full"));
  stop_.Set();
  EXPECT_FALSE(disk_.Wait("full"));
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("full; free space"));
}

TEST(StopFlag, WakesASleeper) {
  StopFlag stop;
  EXPECT_FALSE(stop.Sleep(absl::Milliseconds(1)));
  EXPECT_FALSE(stop.is_set());
  std::thread other([&stop] { stop.Set(); });
  EXPECT_TRUE(stop.Sleep(absl::Minutes(4)));
  EXPECT_TRUE(stop.is_set());
  other.join();
}

}  // namespace
}  // namespace craftfleet
