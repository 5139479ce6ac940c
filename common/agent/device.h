// Where a learner computes: the CPU or a GPU. No LibTorch here.

#ifndef CRAFTFLEET_COMMON_AGENT_DEVICE_H_
#define CRAFTFLEET_COMMON_AGENT_DEVICE_H_

#include <string>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// What --device=`name` means on this machine, as LibTorch writes it: "cpu", or "cuda:N" for its GPU number N. `name` is
// one of these, "cuda" for the first GPU, or "auto" for the first GPU if there is one and the CPU if not.
//   InvalidArgument: it is none of these.   FailedPrecondition: there is no such GPU, or this LibTorch knows none.
absl::StatusOr<std::string> FindDevice(absl::string_view name);

// The same where there are `gpus` GPUs.
absl::StatusOr<std::string> ChooseDevice(absl::string_view name, int gpus);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_AGENT_DEVICE_H_
