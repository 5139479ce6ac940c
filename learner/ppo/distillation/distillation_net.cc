#include "learner/ppo/distillation/distillation_net.h"

#include <cmath>

#include <absl/strings/str_cat.h>

namespace craftfleet {

int CodeSizeOf(const AgentSpec& spec) {
  // The heads see features and memory.
  for (const ParamSpec& param : spec.params) {
    if (param.name == "value_net.weight") return static_cast<int>(param.shape[1]) - spec.state_size;
  }
  return 0;
}

absl::Status CheckNorm(double norm) {
  if (std::isfinite(norm)) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat("distillation: the gradient's norm is ", norm));
}

}  // namespace craftfleet
