// The instruction set that a run pins (RunConfig.cpu): which one a CPU has decides in what order LibTorch and the
// libraries below it add numbers.

#ifndef CRAFTFLEET_COMMON_CPU_PIN_H_
#define CRAFTFLEET_COMMON_CPU_PIN_H_

#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// What --cpu names: "native", "avx2" or "avx512".   InvalidArgument names the flag, the value and these.
absl::StatusOr<v1::RunConfig::Cpu> ParseCpu(absl::string_view name);

// Ok if this CPU has what `cpu` stands for.   FailedPrecondition: it lacks it; says what to do.
absl::Status CheckCpu(v1::RunConfig::Cpu cpu);

// The environment variables, with their values, by which LibTorch (ATen), oneDNN, OpenBLAS and MKL use `cpu`. None for
// NATIVE, which leaves each library its choice.
std::vector<std::pair<std::string, std::string>> CpuPins(v1::RunConfig::Cpu cpu);

// Makes this process compute with `cpu`. The libraries read CpuPins when they are loaded, so a process that began
// without them executes itself again, with the same arguments and process id, and this does not return; whatever it had
// begun is lost. Ok: it computes with `cpu` since its start.   Others: as CheckCpu, or it can't execute itself.
absl::Status PinCpu(v1::RunConfig::Cpu cpu);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_CPU_PIN_H_
