#include "common/process/cpu_pin.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>

#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_split.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

using Cpu = v1::RunConfig;
using Variables = std::vector<std::pair<std::string, std::string>>;

#if defined(__x86_64__)
bool Has(v1::RunConfig::Cpu cpu) {
  __builtin_cpu_init();
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) return false;
  return cpu == Cpu::AVX2 || (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                              __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
                              __builtin_cpu_supports("avx512cd"));
}
#else
bool Has(v1::RunConfig::Cpu /*cpu*/) { return false; }
#endif

bool ArePinned(const Variables& pins) {
  return std::all_of(pins.begin(), pins.end(), [](const auto& pin) {
    const char* value = std::getenv(pin.first.c_str());
    return value != nullptr && value == pin.second;
  });
}

}  // namespace

absl::StatusOr<v1::RunConfig::Cpu> ParseCpu(absl::string_view name) {
  if (name == "native") return Cpu::NATIVE;
  if (name == "avx2") return Cpu::AVX2;
  if (name == "avx512") return Cpu::AVX512;
  return absl::InvalidArgumentError(absl::StrFormat("--cpu=%s, want native, avx2 or avx512", name));
}

absl::Status CheckCpu(v1::RunConfig::Cpu cpu) {
  const bool is_for_config_check = cpu == Cpu::CPU_UNSPECIFIED || !v1::RunConfig::Cpu_IsValid(cpu);
  if (cpu == Cpu::NATIVE || is_for_config_check || Has(cpu)) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrFormat(
      "the run wants cpu: %s, which this machine's CPU lacks (%s): use machines that have it, or begin the run with %s",
      v1::RunConfig::Cpu_Name(cpu), cpu == Cpu::AVX2 ? "avx2 and fma" : "avx512f, bw, dq, vl and cd",
      cpu == Cpu::AVX2 ? "--cpu=native" : "--cpu=avx2"));
}

std::vector<std::pair<std::string, std::string>> CpuPins(v1::RunConfig::Cpu cpu) {
  if (cpu != Cpu::AVX2 && cpu != Cpu::AVX512) return {};
  const bool avx2 = cpu == Cpu::AVX2;
  const char* isa = avx2 ? "AVX2" : "AVX512_CORE";
  const char* mkl = avx2 ? "AVX2" : "AVX512";
  return {{"ATEN_CPU_CAPABILITY", avx2 ? "avx2" : "avx512"},
          {"ONEDNN_MAX_CPU_ISA", isa},
          {"DNNL_MAX_CPU_ISA", isa},  // its name before oneDNN 2.5
          {"OPENBLAS_CORETYPE", avx2 ? "Haswell" : "SkylakeX"},
          {"MKL_ENABLE_INSTRUCTIONS", mkl},
          {"MKL_CBWR", absl::StrCat(mkl, ",STRICT")}};
}

absl::Status PinCpu(v1::RunConfig::Cpu cpu) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckCpu(cpu));
  const Variables pins = CpuPins(cpu);
  if (ArePinned(pins)) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string command_line, ReadFile("/proc/self/cmdline"));
  std::vector<std::string> arguments = absl::StrSplit(command_line, '\0');
  arguments.pop_back();  // each ends with a zero
  std::vector<char*> pointers;
  for (std::string& argument : arguments) pointers.push_back(argument.data());
  pointers.push_back(nullptr);
  for (const auto& [name, value] : pins) setenv(name.c_str(), value.c_str(), /*overwrite=*/1);
  LogInfo("cpu: %s: restarting with it", v1::RunConfig::Cpu_Name(cpu));
  execv("/proc/self/exe", pointers.data());
  return FileError(errno, absl::StrCat("cpu: ", v1::RunConfig::Cpu_Name(cpu), ": cannot execute"), "/proc/self/exe");
}

}  // namespace craftfleet
