// A canary: tells whether the networks of two processes compute the same bits. Does not include LibTorch.

#pragma once

#include <string>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// 16 hexadecimal digits: a digest of every bit that fixed networks with fixed weights compute from fixed frames;
// together they use convolutions, linear layers, an LSTM, attention with softmax, and layer norm; if CPUs of `run`
// multiply in bfloat16, also convolutions and linear layers that do. Builds, libraries or CPUs that round differently
// give another digest. Computed once in a process, in some tens of milliseconds, with bfloat16 some tenths of a second;
// thread-safe.
//   InvalidArgument: this CPU can't multiply in bfloat16.   Internal: LibTorch failed.
absl::StatusOr<std::string> PolicyCanary(const v1::RunConfig& run = {});

// The expected PolicyCanary, without bfloat16, of a process that is pinned to `cpu` (common/process/cpu_pin.h), on
// every machine. Empty: unknown for this cpu, or for the version of LibTorch in this build, whose kernels may add in
// another order.
absl::string_view KnownPolicyCanary(v1::RunConfig::Cpu cpu);

}  // namespace craftfleet
