#include "common/process/cpu_pin.h"

#include <stdlib.h>
#include <unistd.h>

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Pair;

TEST(CpuPin, ParsesTheValuesOfTheFlag) {
  EXPECT_EQ(*ParseCpu("native"), v1::RunConfig::NATIVE);
  EXPECT_EQ(*ParseCpu("avx2"), v1::RunConfig::AVX2);
  EXPECT_EQ(*ParseCpu("avx512"), v1::RunConfig::AVX512);
  EXPECT_THAT(ParseCpu("sse"), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("--cpu=sse, want native, avx2")));
}

TEST(CpuPin, PinsCoverEveryLibrary) {
  EXPECT_THAT(CpuPins(v1::RunConfig::NATIVE), IsEmpty());
  EXPECT_THAT(CpuPins(v1::RunConfig::AVX2),
              AllOf(Contains(Pair("ATEN_CPU_CAPABILITY", "avx2")), Contains(Pair("ONEDNN_MAX_CPU_ISA", "AVX2")),
                    Contains(Pair("OPENBLAS_CORETYPE", "Haswell")), Contains(Pair("MKL_CBWR", "AVX2,STRICT"))));
  EXPECT_THAT(CpuPins(v1::RunConfig::AVX512), Contains(Pair("OPENBLAS_CORETYPE", "SkylakeX")));
}

// In a process of its own: one that restarts runs these tests and exits with another code.
TEST(CpuPin, NativeDoesNotRestartTheProcess) {
  EXPECT_EXIT(_exit(PinCpu(v1::RunConfig::NATIVE).ok() ? 7 : 1), testing::ExitedWithCode(7), "");
}

TEST(CpuPin, APinnedProcessDoesNotRestart) {
  if (!CheckCpu(v1::RunConfig::AVX2).ok()) GTEST_SKIP() << "a CPU without AVX2";
  // In a separate process, so that its environment does not affect other tests.
  EXPECT_EXIT(
      {
        for (const auto& [name, value] : CpuPins(v1::RunConfig::AVX2)) setenv(name.c_str(), value.c_str(), 1);
        _exit(PinCpu(v1::RunConfig::AVX2).ok() ? 7 : 1);
      },
      testing::ExitedWithCode(7), "");
}

}  // namespace
}  // namespace craftfleet
