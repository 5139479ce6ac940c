// What one PPO iteration learns from.

#ifndef CRAFTFLEET_LEARNER_PPO_ROLLOUT_H_
#define CRAFTFLEET_LEARNER_PPO_ROLLOUT_H_

#include <cstddef>
#include <cstdint>
#include <vector>

#include <absl/status/status.h>

#include "common/crafter.h"
#include "common/types.h"
#include "learner/ppo/gae.h"

namespace craftfleet {

// Rows are steps. Frames stay where they are: in the fragments, which must outlive the rollout.
struct Rollout {
  std::vector<const uint8_t*> frames;  // [n] -> uint8[H,W,3]
  std::vector<Action> actions;         // [n]
  std::vector<float> log_probs;        // [n] when the action was chosen
  std::vector<float> values;           // [n] likewise
  std::vector<float> advantages;       // [n] not normalised
  std::vector<float> returns;          // [n]

  size_t size() const { return actions.size(); }
};

// Adds the fragment's T steps, with advantages from GAE over the fragment alone.
//   InvalidArgument: the fragment's fields don't have T steps (frames: T * frame_bytes bytes), or an action is not
//   0..16; the rollout is untouched.
absl::Status AppendFragment(const Fragment& fragment, int64_t frame_bytes, const GaeOptions& gae, Rollout* rollout);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_ROLLOUT_H_
