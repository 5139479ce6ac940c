// Plays whole episodes with a fixed policy, to score it.

#ifndef CRAFTFLEET_ACTOR_EVALUATOR_H_
#define CRAFTFLEET_ACTOR_EVALUATOR_H_

#include <cstdint>
#include <functional>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "actor/env_client.h"
#include "actor/episode_observer.h"
#include "common/agent/policy.h"
#include "common/types.h"

namespace craftfleet {

struct EvaluationOptions {
  int64_t seed = 0;               // of the environment
  int64_t first_episode = 1;      // episodes first_episode .. first_episode + episodes - 1 of that environment
  int episodes = 10;              // 1..10000; none beyond episode 2^31-1
  bool greedy = false;            // the likeliest action instead of a drawn one
  int lanes = 16;                 // episodes played side by side; the result does not depend on it
  absl::Status Validate() const;  // InvalidArgument names the field and its range
};

// The episodes in order of their number. `env` is connected. `on_episode` is called after each with the number finished
// so far. `observer`, if not null, sees all of it; `env` is a session that records then.
//   Errors as EnvClient, Policy and EpisodeObserver.
absl::StatusOr<std::vector<Episode>> Evaluate(const EvaluationOptions& options, const Policy& policy, EnvClient* env,
                                              const std::function<void(int)>& on_episode,
                                              EpisodeObserver* observer = nullptr);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_EVALUATOR_H_
