// The instruction set that a run pins (RunConfig.cpu). It determines the order in which LibTorch and the libraries
// under it add numbers, and so the last bits of results.

#pragma once

#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// Parses a value of --cpu: "native", "avx2" or "avx512".   InvalidArgument names the flag, the value and these.
absl::StatusOr<v1::RunConfig::Cpu> ParseCpu(absl::string_view name);

// OK if this CPU has the instruction set `cpu`.   FailedPrecondition: it does not; the message says what to do.
absl::Status CheckCpu(v1::RunConfig::Cpu cpu);

// The environment variables, with their values, that make LibTorch (ATen), oneDNN, OpenBLAS and MKL use `cpu`. None for
// NATIVE: each library makes its own choice.
std::vector<std::pair<std::string, std::string>> CpuPins(v1::RunConfig::Cpu cpu);

// Makes this process compute with `cpu`. The libraries read CpuPins when they are loaded, so a process that started
// without them executes itself again, with the same arguments and process id: then this does not return, and unsaved
// work is lost. Call it before other threads use the environment. OK: it has used `cpu` since its start.   Errors as
// CheckCpu, or it cannot execute itself.
absl::Status PinCpu(v1::RunConfig::Cpu cpu);

}  // namespace craftfleet
