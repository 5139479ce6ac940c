#include "common/agent/torch_setup.h"

#include <csignal>
#include <string>
#include <thread>
#include <vector>

#include <absl/strings/str_split.h>
#include <c10/util/Exception.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

TEST(SetUpTorchThread, LogsEachWarningOfLibTorchOnce) {
  testing::internal::CaptureStderr();
  for (int i = 0; i < 2; ++i) {
    std::thread([] {
      SetUpTorchThread();
      for (const char* text : {"weights are scattered", "weights are scattered", "too old"}) TORCH_WARN(text);
    }).join();
  }
  const std::string log = testing::internal::GetCapturedStderr();
  EXPECT_THAT(std::vector<std::string>(absl::StrSplit(log, '\n', absl::SkipEmpty())),
              ElementsAre(HasSubstr("warning: LibTorch: weights are scattered"), HasSubstr("LibTorch: too old")));
}

TEST(SetUpTorchThread, SignalsThatStopAProgramDoNotInterruptTheThread) {
  bool is_blocked = false;
  std::thread([&is_blocked] {
    SetUpTorchThread();
    sigset_t blocked;
    pthread_sigmask(SIG_BLOCK, nullptr, &blocked);
    is_blocked = sigismember(&blocked, SIGTERM) == 1;
  }).join();
  EXPECT_TRUE(is_blocked);
}

}  // namespace
}  // namespace craftfleet
