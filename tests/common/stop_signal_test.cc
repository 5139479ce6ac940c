#include <unistd.h>

#include <atomic>
#include <csignal>
#include <thread>

#include <gtest/gtest.h>

#include "common/program.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

TEST(StopSignal, CallsStopOnAThreadOfItsOwn) {
  for (const int number : {SIGTERM, SIGINT}) {
    std::atomic<int> stops{0};
    StopSignal signal([&stops, here = std::this_thread::get_id()] {
      EXPECT_NE(std::this_thread::get_id(), here);
      ++stops;
    });
    raise(number);
    EXPECT_TRUE(WaitUntil([&] { return stops == 1; }));
  }
}

// A program that hangs while it stops.
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

TEST(StopSignalDeathTest, TheSecondSignalEndsTheProcessWhileItStops) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(StopForEver(), testing::ExitedWithCode(130), "");
}

}  // namespace
}  // namespace craftfleet
