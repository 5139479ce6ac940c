#include "common/agent/device.h"

#include <ATen/Context.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

TEST(ChooseDevice, TakesAGpuWhereThereIsOne) {
  EXPECT_EQ(*ChooseDevice("auto", 0), "cpu");
  EXPECT_EQ(*ChooseDevice("auto", 2), "cuda:0");
  EXPECT_EQ(*ChooseDevice("cpu", 2), "cpu");
  EXPECT_EQ(*ChooseDevice("cuda", 2), "cuda:0");
  EXPECT_EQ(*ChooseDevice("cuda:1", 2), "cuda:1");
}

TEST(ChooseDevice, SaysWhatIsWrong) {
  for (const char* name : {"", "gpu", "cuda:", "cuda:x", "cuda:-1", "cuda1", "CUDA", "cpu:0"}) {
    EXPECT_THAT(ChooseDevice(name, 2),
                StatusIs(absl::StatusCode::kInvalidArgument,
                         AllOf(HasSubstr(std::string("--device=") + name), HasSubstr("want auto"))))
        << name;
  }
  EXPECT_THAT(ChooseDevice("cuda:2", 2),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("there are 2 GPUs")));
  EXPECT_THAT(ChooseDevice("cuda", 0), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("there are 0 GPUs")));
}

TEST(FindDevice, NamesWhatLibTorchLacks) {
  EXPECT_THAT(FindDevice("auto"), IsOk());
  if (at::hasCUDA()) GTEST_SKIP() << "this LibTorch has CUDA";
  EXPECT_EQ(*FindDevice("auto"), "cpu");
  EXPECT_THAT(FindDevice("cuda:0"), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("without CUDA")));
}

}  // namespace
}  // namespace craftfleet
