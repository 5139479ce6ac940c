// Plays whole episodes with a fixed policy.

#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "actor/env_client.h"
#include "actor/episode_observer.h"
#include "common/agent/policy.h"
#include "common/base/types.h"

namespace craftfleet {

struct EvaluationOptions {
  int64_t seed = 0;               // of the environment
  int64_t first_episode = 1;      // episodes first_episode .. first_episode + episodes - 1 of that environment
  int episodes = 10;              // 1..10000; none beyond episode 2^31-1
  bool greedy = false;            // play the most probable action instead of a sampled one
  int lanes = 16;                 // episodes played side by side; the result does not depend on it
  absl::Status Validate() const;  // InvalidArgument names the field and its range
};

// Plays episodes and returns them ordered by number. `env` must be connected. `on_step` is called after each step with
// the number of finished episodes. `observer`, if not null, receives every step; the session of `env` must record then.
// Once `*stop` is true (`stop` may be null), no further step is played, and only finished episodes are returned.
//   Errors as EnvClient, Policy and EpisodeObserver.
absl::StatusOr<std::vector<Episode>> Evaluate(const EvaluationOptions& options, const Policy& policy, EnvClient* env,
                                              const std::function<void(int)>& on_step,
                                              EpisodeObserver* observer = nullptr,
                                              const std::atomic<bool>* stop = nullptr);

}  // namespace craftfleet
