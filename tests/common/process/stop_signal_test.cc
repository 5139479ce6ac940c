#include <unistd.h>

#include <atomic>
#include <csignal>
#include <thread>

#include <gtest/gtest.h>

#include "common/process/program.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

TEST(StopSignal, CallsStopOnAThreadOfItsOwn) {
  for (const int number : {SIGTERM, SIGINT, SIGHUP}) {
    signal(SIGHUP, SIG_DFL);  // the one before leaves it ignored
    std::atomic<int> stops{0};
    StopSignal signal([&stops, here = std::this_thread::get_id()] {
      EXPECT_NE(std::this_thread::get_id(), here);
      ++stops;
    });
    raise(number);
    EXPECT_TRUE(WaitUntil([&] { return stops == 1; }));
  }
}

TEST(StopSignal, HangupsCallStopOnceAndNeverForceAnExit) {
  std::atomic<int> stops{0};
  {
    StopSignal signal([&stops] { ++stops; });
    raise(SIGHUP);
    raise(SIGHUP);
    raise(SIGTERM);
    raise(SIGHUP);
    EXPECT_TRUE(WaitUntil([&] { return stops == 1; }));
  }
  EXPECT_EQ(stops, 1);
  raise(SIGHUP);  // a second hangup, while the process ends
  signal(SIGHUP, SIG_DFL);
}

TEST(StopSignal, LeavesAnIgnoredHangupIgnored) {
  signal(SIGHUP, SIG_IGN);  // as nohup does
  std::atomic<int> stops{0};
  {
    StopSignal signal([&stops] { ++stops; });
    raise(SIGHUP);
  }
  EXPECT_EQ(stops, 0);
  signal(SIGHUP, SIG_DFL);
}

// A program whose stop function never returns.
[[noreturn]] void StopForEver() {
  std::atomic<bool> stopping{false};
  StopSignal signal([&stopping] {
    stopping = true;
    while (true) pause();
  });
  raise(SIGTERM);
  WaitUntil([&] { return stopping.load(); });
  raise(SIGTERM);
  _exit(1);
}

TEST(StopSignalDeathTest, ASecondSignalEndsTheProcessDuringStop) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(StopForEver(), testing::ExitedWithCode(130), "");
}

}  // namespace
}  // namespace craftfleet
