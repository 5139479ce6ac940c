// The number of steps that a run trains.

#pragma once

#include <cstdint>

#include "craftfleet/v1/config.pb.h"

namespace craftfleet {

// Environment steps after which the run of `config`, a complete one, ends: its `steps`, rounded up to whole iterations.
inline int64_t StepsToTrain(const v1::RunConfig& config) {
  const int64_t iteration = config.ppo().rollout_steps();
  return (config.steps() + iteration - 1) / iteration * iteration;
}

}  // namespace craftfleet
