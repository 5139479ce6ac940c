// The optimisers of distillation.

#ifndef CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_ADAMS_H_
#define CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_ADAMS_H_

#include "learner/ppo/adam.h"

namespace craftfleet {

// Those of the two losses, beside PPO's, over the same weights.
struct DistillationAdams {
  AdamState matching;
  AdamState prediction;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_ADAMS_H_
