// A canary: tells whether two processes' networks compute the same bits. No LibTorch here.

#ifndef CRAFTFLEET_COMMON_AGENT_CANARY_H_
#define CRAFTFLEET_COMMON_AGENT_CANARY_H_

#include <string>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// 16 hexadecimal digits: a digest of every bit that fixed networks with fixed weights, which go through convolutions,
// linear layers, an LSTM, attention with its softmax and layer norm, make of fixed frames. Builds, libraries or CPUs
// that round differently give another. Computed once in a process, in some tens of milliseconds; thread-safe.
//   Internal: LibTorch failed.
absl::StatusOr<std::string> PolicyCanary();

// What PolicyCanary must be in a process that is pinned to `cpu` (common/cpu_pin.h), on every machine. Empty: not known
// for this cpu or for the version of LibTorch that we are built against, whose kernels may add in another order.
absl::string_view KnownPolicyCanary(v1::RunConfig::Cpu cpu);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_CANARY_H_
