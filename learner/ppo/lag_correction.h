// Rollouts that older weights played, corrected with what the first epoch says about them (Hilton et al. 2021).
// Equations: PPO.md, section 10.

#pragma once

#include <cstddef>
#include <vector>

#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/gae.h"
#include "learner/ppo/rollout.h"
#include "learner/ppo/update_stats.h"

namespace craftfleet {

// Whether updates correct their rollout after the first epoch: where older weights play, there are several epochs, and
// the network has no dropout, whose noise would be taken for lag.
bool CorrectsLag(const v1::RunConfig& config, const v1::NetworkConfig& network);

GaeOptions GaeOptionsOf(const v1::PpoConfig& config);

// What the first epoch says about the rollout's steps: the outputs that each step was learned from.
struct StartOutputs {
  explicit StartOutputs(size_t n) : log_probs(n), values(n) {}
  std::vector<float> log_probs;  // [n] of the actions
  std::vector<float> values;     // [n] not normalised
};

struct CorrectedRollout {
  Rollout rollout;
  ImportanceStats importance;
};

// `rollout` as the other epochs use it; n > 0. The start's log-probabilities and values replace the rollout's, the
// importance weights become Rollout::weights, and advantages and returns are computed from the new values.
CorrectedRollout CorrectLag(const Rollout& rollout, const StartOutputs& start, const v1::PpoConfig& config);

}  // namespace craftfleet
