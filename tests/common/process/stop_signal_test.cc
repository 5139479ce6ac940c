#include <unistd.h>

#include <atomic>
#include <csignal>
#include <thread>

#include <absl/time/clock.h>
#include <gtest/gtest.h>

#include "common/process/program.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

// As a shell or a supervisor does: to the process, not to a thread.
void Send(int signal) { kill(getpid(), signal); }

TEST(StopSignal, CallsStopOnAThreadOfItsOwn) {
  for (const int number : {SIGTERM, SIGINT, SIGHUP}) {
    signal(SIGHUP, SIG_DFL);  // the one before leaves it ignored
    std::atomic<int> stops{0};
    StopSignal signal([&stops, here = std::this_thread::get_id()] {
      EXPECT_NE(std::this_thread::get_id(), here);
      ++stops;
    });
    Send(number);
    EXPECT_TRUE(WaitUntil([&] { return stops == 1; }));
  }
}

// A handler would write its frame where oneDNN's code has put the stack pointer.
TEST(StopSignal, TheThreadThatHasItIsNotInterrupted) {
  const auto is_blocked = [](int signal) {
    sigset_t blocked;
    pthread_sigmask(SIG_BLOCK, nullptr, &blocked);
    return sigismember(&blocked, signal) == 1;
  };
  {
    const StopSignal stop([&] { EXPECT_FALSE(is_blocked(SIGTERM)); });
    for (const int signal : {SIGTERM, SIGINT, SIGHUP}) EXPECT_TRUE(is_blocked(signal));
    bool blocked_there = false;
    std::thread([&] { blocked_there = is_blocked(SIGTERM); }).join();
    EXPECT_TRUE(blocked_there) << "nor are threads that it starts";
    Send(SIGTERM);
  }
  EXPECT_FALSE(is_blocked(SIGTERM));
}

TEST(StopSignal, HangupsCallStopOnceAndNeverForceAnExit) {
  std::atomic<int> stops{0};
  {
    StopSignal signal([&stops] { ++stops; });
    Send(SIGHUP);
    Send(SIGHUP);
    Send(SIGTERM);
    Send(SIGHUP);
    EXPECT_TRUE(WaitUntil([&] { return stops == 1; }));
  }
  EXPECT_EQ(stops, 1);
  Send(SIGHUP);  // a second hangup, while the process ends
  signal(SIGHUP, SIG_DFL);
}

// timeout(1) sends one to its child and one to the child's group.
TEST(StopSignal, TwoAtOnceAreOneRequest) {
  std::atomic<int> stops{0};
  {
    StopSignal signal([&stops] { ++stops; });
    Send(SIGTERM);
    Send(SIGINT);  // a second SIGTERM might merge with the first
    EXPECT_TRUE(WaitUntil([&] {
      sigset_t waiting;
      sigpending(&waiting);
      return stops == 1 && sigismember(&waiting, SIGTERM) == 0 && sigismember(&waiting, SIGINT) == 0;
    }));
  }
  EXPECT_EQ(stops, 1);
}

TEST(StopSignal, LeavesAnIgnoredHangupIgnored) {
  signal(SIGHUP, SIG_IGN);  // as nohup does
  std::atomic<int> stops{0};
  {
    StopSignal signal([&stops] { ++stops; });
    Send(SIGHUP);
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
  Send(SIGTERM);
  WaitUntil([&] { return stopping.load(); });
  absl::SleepFor(absl::Milliseconds(600));  // sooner it would be the same request
  Send(SIGTERM);
  sleep(10);  // it reaches another thread
  _exit(1);
}

// A program that has saved all and is about to end.
[[noreturn]] void EndSlowly(int signals) {
  {
    const StopSignal signal([] {});
  }
  Send(SIGTERM);
  if (signals == 2) {
    absl::SleepFor(absl::Milliseconds(600));
    Send(SIGINT);
  }
  _exit(0);
}

TEST(StopSignalDeathTest, OnlyASecondSignalChangesTheExitCodeOfAProgramThatHasDoneAll) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(EndSlowly(1), testing::ExitedWithCode(0), "");
  EXPECT_EXIT(EndSlowly(2), testing::ExitedWithCode(130), "");
}

TEST(StopSignalDeathTest, ASecondSignalEndsTheProcessDuringStop) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(StopForEver(), testing::ExitedWithCode(130), "");
}

}  // namespace
}  // namespace craftfleet
