#include "common/agent/device.h"

#include <ATen/Context.h>
#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/strip.h>

namespace craftfleet {

absl::StatusOr<std::string> FindDevice(absl::string_view name) {
  if (!at::hasCUDA() && absl::StartsWith(name, "cuda")) {
    return absl::FailedPreconditionError(absl::StrFormat(
        "--device=%s: LibTorch was built without CUDA or finds no driver: build against one that has it "
        "(-DCRAFTFLEET_LIBTORCH=DIR), or take --device=cpu",
        name));
  }
  return ChooseDevice(name, static_cast<int>(at::getNumGPUs()));
}

absl::StatusOr<std::string> ChooseDevice(absl::string_view name, int gpus) {
  if (name == "cpu" || (name == "auto" && gpus == 0)) return "cpu";
  if (name == "auto" || name == "cuda") name = "cuda:0";
  absl::string_view digits = name;
  int number = 0;
  if (!absl::ConsumePrefix(&digits, "cuda:") || !absl::SimpleAtoi(digits, &number) || number < 0) {
    return absl::InvalidArgumentError(absl::StrFormat("--device=%s, want auto, cpu, cuda or cuda:N", name));
  }
  if (number >= gpus) {
    return absl::FailedPreconditionError(
        absl::StrFormat("--device=%s: there are %d GPUs, numbered from 0", name, gpus));
  }
  return absl::StrCat("cuda:", number);
}

}  // namespace craftfleet
