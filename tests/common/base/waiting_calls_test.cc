#include "common/base/waiting_calls.h"

#include <algorithm>
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include <absl/time/time.h>
#include <gtest/gtest.h>

#include "common/base/closable_queue.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kLong = absl::Seconds(60);

class WaitingCallsTest : public testing::Test {
 protected:
  // Waits until it is allowed to succeed. Reports each attempt.
  void Add(const std::string& caller) {
    calls_->Add(
        [this, caller](bool last) {
          const bool done = last || allowed_;  // as it was before the test could know of the attempt
          attempts_.Push(caller).IgnoreError();
          return done;
        },
        kLong, caller);
  }
  std::string NextAttempt() { return attempts_.Pop(kLong).value_or("none"); }

  std::atomic<bool> allowed_{false};
  ClosableQueue<std::string> attempts_{1000};
  std::unique_ptr<WaitingCalls> calls_ = std::make_unique<WaitingCalls>();
};

TEST_F(WaitingCallsTest, AChangeForOneCallerCostsNoAttemptOfOthers) {
  for (const char* caller : {"a", "b", "c"}) Add(caller);
  for (int i = 0; i < 3; ++i) NextAttempt();
  allowed_ = true;
  calls_->Retry("b");
  EXPECT_EQ(NextAttempt(), "b");
  calls_->Retry("nobody");
  calls_->Retry("a");
  EXPECT_EQ(NextAttempt(), "a") << "and none of c";
}

TEST_F(WaitingCallsTest, AChangeForAllRetriesEach) {
  for (const char* caller : {"a", "b", ""}) Add(caller);
  for (int i = 0; i < 3; ++i) NextAttempt();
  calls_->Retry();
  std::vector<std::string> retried = {NextAttempt(), NextAttempt(), NextAttempt()};
  std::sort(retried.begin(), retried.end());
  EXPECT_EQ(retried, (std::vector<std::string>{"", "a", "b"}));
  // An attempt reports before its call waits again.
  EXPECT_TRUE(WaitUntil([this] { return calls_->size() == 3; }, kLong)) << calls_->size();
}

TEST_F(WaitingCallsTest, AllCallsOfACallerAreRetried) {
  Add("a");
  Add("a");
  for (int i = 0; i < 2; ++i) NextAttempt();
  allowed_ = true;
  calls_->Retry("a");
  EXPECT_EQ(NextAttempt(), "a");
  EXPECT_EQ(NextAttempt(), "a");
}

TEST_F(WaitingCallsTest, AChangeDuringAnAttemptIsNotMissed) {
  calls_->Add(
      [this, attempt = 0](bool /*last*/) mutable {
        ++attempt;
        if (attempt == 1) calls_->Retry("a");  // the caller is not known to wait yet
        if (attempt == 2) calls_->Retry();
        attempts_.Push("attempt").IgnoreError();
        return attempt == 3;
      },
      kLong, "a");
  for (int i = 0; i < 3; ++i) EXPECT_EQ(NextAttempt(), "attempt");
}

TEST_F(WaitingCallsTest, AWaitThatEndsMakesTheLastAttempt) {
  calls_->Add(
      [this](bool last) {
        attempts_.Push(last ? "last" : "first").IgnoreError();
        return last;
      },
      absl::Milliseconds(1), "a");
  EXPECT_EQ(NextAttempt(), "first");
  EXPECT_EQ(NextAttempt(), "last");
}

TEST_F(WaitingCallsTest, DestructionMakesTheLastAttemptOfAll) {
  Add("a");
  Add("b");
  calls_.reset();
  EXPECT_EQ(attempts_.size(), 4);
}

}  // namespace
}  // namespace craftfleet
