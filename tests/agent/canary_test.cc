#include "common/agent/canary.h"

#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/process/cpu_pin.h"
#include "tests/fakes/command_output.h"
#include "tests/fakes/sanitizers.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/test_paths.h"

namespace craftfleet {
namespace {

using testing::MatchesRegex;
using testing::StartsWith;

// The output of print_canary in a process with the additional environment `variables`.
std::string Printed(const std::string& cpu, const std::string& variables = "") {
  return OutputOf(absl::StrCat("(", variables, " ", BuiltProgram("print_canary"), " ", cpu, " 2>/dev/null)"));
}

TEST(PolicyCanary, IsTheSameInEveryProcessOfAMachine) {
  const auto canary = PolicyCanary();
  ASSERT_THAT(canary, IsOk());
  EXPECT_THAT(*canary, MatchesRegex("[0-9a-f]{16}"));
  EXPECT_EQ(PolicyCanary(), canary);
  EXPECT_EQ(Printed("native"), *canary + "\n");
}

// The guarantee of `cpu: AVX2`: the same bits on every machine.
TEST(PolicyCanary, WithAvx2MatchesTheKnownOne) {
  if (!CheckCpu(v1::RunConfig::AVX2).ok()) GTEST_SKIP() << "a CPU without AVX2";
  const absl::string_view known = KnownPolicyCanary(v1::RunConfig::AVX2);
  if (known.empty()) GTEST_SKIP() << "the canary of this LibTorch is not known";
  EXPECT_EQ(Printed("avx2"), absl::StrCat(known, "\n"));
  EXPECT_EQ(Printed("avx2", "OPENBLAS_CORETYPE=Prescott ATEN_CPU_CAPABILITY=default"), absl::StrCat(known, "\n"))
      << "the pin must win";
}

// Libraries also choose their code by the CPU's vendor. The emulator has a CPU of the other vendor; it takes a minute
// and a half. The pins are in its environment from the start, since a process that executes itself again would leave
// the emulator.
TEST(PolicyCanary, WithAvx2IsTheSameOnAnEmulatedCpuOfTheOtherVendor) {
  if (OutputOf("command -v qemu-x86_64").empty())
    GTEST_SKIP() << "qemu-x86_64 is missing: deploy/install-deps.sh --tests";
  const absl::string_view known = KnownPolicyCanary(v1::RunConfig::AVX2);
  if (known.empty()) GTEST_SKIP() << "the canary of this LibTorch is not known";
  if (kAddressSanitizer) GTEST_SKIP() << "the emulator would keep AddressSanitizer's shadow in memory";
  std::string pins;
  for (const auto& [name, value] : CpuPins(v1::RunConfig::AVX2)) absl::StrAppend(&pins, name, "=", value, " ");
  const absl::string_view cpu = OutputOf("grep -m1 AuthenticAMD /proc/cpuinfo").empty() ? "EPYC" : "Haswell";
  EXPECT_EQ(OutputOf(absl::StrCat("(", pins, "qemu-x86_64 -cpu ", cpu, " ", BuiltProgram("print_canary"),
                                  " avx2 2>/dev/null)")),
            absl::StrCat(known, "\n"))
      << cpu;
}

// The canary depends on rounding.
TEST(PolicyCanary, DiffersBetweenInstructionSets) {
  if (!CheckCpu(v1::RunConfig::AVX2).ok()) GTEST_SKIP() << "a CPU without AVX2";
  const std::string plain = Printed("native",
                                    "ATEN_CPU_CAPABILITY=default ONEDNN_MAX_CPU_ISA=SSE41 "
                                    "DNNL_MAX_CPU_ISA=SSE41 OPENBLAS_CORETYPE=Prescott");
  EXPECT_THAT(plain, MatchesRegex("[0-9a-f]{16}\n"));
  EXPECT_NE(plain, Printed("avx2"));
}

TEST(PolicyCanary, OfARunInBfloat16DependsOnItsInstructions) {
  if (OutputOf("grep -m1 avx512_bf16 /proc/cpuinfo").empty()) GTEST_SKIP() << "a CPU without AVX512-BF16";
  const std::string printed = Printed("native bf16");
  EXPECT_THAT(printed, MatchesRegex("[0-9a-f]{16}\n"));
  EXPECT_EQ(Printed("native bf16"), printed);
  const std::string emulated = "ONEDNN_MAX_CPU_ISA=AVX512_CORE DNNL_MAX_CPU_ISA=AVX512_CORE";
  EXPECT_THAT(Printed("native bf16", emulated), MatchesRegex("[0-9a-f]{16}\n"));
  EXPECT_NE(Printed("native bf16", emulated), printed);
}

TEST(PolicyCanary, OfARunThatActsOnGpusIsThatOfFloat32) {
  v1::RunConfig run;
  run.set_precision(v1::RunConfig::BF16);
  run.set_device(v1::RunConfig::CUDA);
  EXPECT_EQ(PolicyCanary(run), PolicyCanary());
}

TEST(PolicyCanary, WithAvx512IsComputedOrRefused) {
  if (CheckCpu(v1::RunConfig::AVX512).ok()) {
    EXPECT_THAT(Printed("avx512"), MatchesRegex("[0-9a-f]{16}\n"));
  } else {
    EXPECT_THAT(Printed("avx512"), StartsWith("error: the run wants cpu: AVX512"));
  }
}

}  // namespace
}  // namespace craftfleet
