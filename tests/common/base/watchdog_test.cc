#include "common/base/watchdog.h"

#include <atomic>
#include <thread>
#include <vector>

#include <absl/time/clock.h>
#include <gtest/gtest.h>

#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

TEST(Watchdog, CallsBackOncePerArmAfterTheLimit) {
  Watchdog watchdog;
  std::atomic<int> calls{0};
  Watchdog::Timer timer(&watchdog, [&] { ++calls; });
  const absl::Time start = absl::Now();
  timer.Arm(absl::Milliseconds(50));
  ASSERT_TRUE(WaitUntil([&] { return calls > 0; }));
  EXPECT_GE(absl::Now() - start, absl::Milliseconds(49));
  absl::SleepFor(absl::Milliseconds(100));
  EXPECT_EQ(calls, 1);
  EXPECT_TRUE(timer.Disarm());
  EXPECT_FALSE(timer.Disarm()) << "reported once";
  timer.Arm(absl::Milliseconds(1));
  EXPECT_TRUE(WaitUntil([&] { return calls == 2; })) << "armed again";
}

TEST(Watchdog, DoesNotCallBackAfterDisarm) {
  Watchdog watchdog;
  std::atomic<int> calls{0};
  Watchdog::Timer timer(&watchdog, [&] { ++calls; });
  timer.Arm(absl::Milliseconds(100));
  EXPECT_FALSE(timer.Disarm());
  timer.Arm(absl::InfiniteDuration());
  absl::SleepFor(absl::Milliseconds(200));
  EXPECT_EQ(calls, 0);
}

TEST(Watchdog, MeetsAnEarlierDeadlineArmedAfterALaterOne) {
  Watchdog watchdog;
  std::atomic<bool> late{false};
  std::atomic<bool> early{false};
  Watchdog::Timer first(&watchdog, [&] { late = true; });
  Watchdog::Timer second(&watchdog, [&] { early = true; });
  first.Arm(absl::Hours(1));
  second.Arm(absl::Milliseconds(20));
  EXPECT_TRUE(WaitUntil([&] { return early.load(); }));
  EXPECT_FALSE(late);
}

TEST(Watchdog, ManyThreadsArmAndDisarm) {
  Watchdog watchdog;
  std::atomic<int> overdue{0};
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&] {
      Watchdog::Timer timer(&watchdog, [&] { ++overdue; });
      for (int k = 0; k < 1000; ++k) {
        timer.Arm(absl::Hours(1));
        EXPECT_FALSE(timer.Disarm());
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(overdue, 0);
}

}  // namespace
}  // namespace craftfleet
