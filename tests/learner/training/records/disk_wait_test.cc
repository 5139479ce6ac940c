#include "learner/training/records/disk_wait.h"

#include <algorithm>
#include <cerrno>
#include <string>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/fake_clock.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

class DiskWaitTest : public testing::Test {
 protected:
  static absl::Status Full(const std::string& text) { return absl::ResourceExhaustedError(text); }

  FakeClock clock_;
  StopFlag stop_;
  DiskWait disk_{&stop_, &clock_, absl::ZeroDuration()};
};

TEST_F(DiskWaitTest, ReportsEveryFifteenSeconds) {
  testing::internal::CaptureStderr();
  disk_.Report(Full("stats.jsonl is full"), "logs wait");
  disk_.Report(Full("a second one"), "logs wait");
  clock_.Advance(DiskWait::kReportEvery - absl::Seconds(1));
  disk_.Report(Full("a third one"), "logs wait");
  clock_.Advance(absl::Seconds(1));
  disk_.Report(Full("it is still full"), "logs wait");
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(log, HasSubstr("error: stats.jsonl is full; logs wait; free space on that disk"));
  EXPECT_THAT(log, HasSubstr("error: it is still full; logs wait; free space"));
  EXPECT_EQ(std::count(log.begin(), log.end(), '\n'), 2) << log;
}

TEST_F(DiskWaitTest, AdvisesWhatHelpsAgainstTheError) {
  const auto reported = [this](int error_number) {
    testing::internal::CaptureStderr();
    disk_.Report(FileError(error_number, "cannot write", "stats.jsonl"), "logs wait");
    clock_.Advance(DiskWait::kReportEvery);
    return testing::internal::GetCapturedStderr();
  };
  for (const int full : {ENOSPC, EDQUOT, EFBIG}) EXPECT_THAT(reported(full), HasSubstr("; free space on that disk"));
  for (const int failing : {EIO, ESTALE, ENXIO}) {
    EXPECT_THAT(reported(failing), AllOf(HasSubstr("; check that disk"), Not(HasSubstr("free space"))));
  }
  for (const int denied : {EACCES, EROFS}) EXPECT_THAT(reported(denied), HasSubstr("; make that disk writable"));
}

TEST_F(DiskWaitTest, WaitsUntilTrainingIsStopped) {
  testing::internal::CaptureStderr();
  EXPECT_TRUE(disk_.Wait(Full("full"), "training waits"));
  stop_.Set();
  EXPECT_FALSE(disk_.Wait(Full("full"), "training waits"));
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("full; training waits; free space"));
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
