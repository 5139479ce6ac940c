// An interface for observing episodes while they are played.

#pragma once

#include <cstdint>

#include <absl/status/status.h>

#include "common/base/crafter.h"
#include "common/base/types.h"

namespace craftfleet {

struct ObservedStep {
  Action action = Action::kNoop;
  float reward = 0;
  StepEnd end = StepEnd::kNone;  // not kNone: the step was the episode's last
};

// Receives each episode from its first moment to its last; several episodes run side by side. An error ends the
// evaluation. Called from one thread.
class EpisodeObserver {
 public:
  virtual ~EpisodeObserver() = default;
  // Episode `number` of the environment begins.
  virtual absl::Status OnStart(int64_t number, const Moment& moment) = 0;
  // A step of episode `number`, and the moment after it.
  virtual absl::Status OnStep(int64_t number, const ObservedStep& step, const Moment& moment) = 0;
};

}  // namespace craftfleet
