#include "learner/ppo/distillation/distillation_net.h"

namespace craftfleet {

int CodeSizeOf(const AgentSpec& spec) {
  // The heads see features and memory.
  for (const ParamSpec& param : spec.params) {
    if (param.name == "value_net.weight") return static_cast<int>(param.shape[1]) - spec.state_size;
  }
  return 0;
}

}  // namespace craftfleet
