// Rollouts that older weights played: the decoupled objective (Hilton et al. 2021) and V-trace's weights (Espeholt et
// al. 2018). Equations: PPO.md, section 10.

#ifndef CRAFTFLEET_LEARNER_PPO_LAG_CORRECTION_H_
#define CRAFTFLEET_LEARNER_PPO_LAG_CORRECTION_H_

#include <cstddef>
#include <vector>

#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/gae.h"
#include "learner/ppo/rollout.h"
#include "learner/ppo/update_stats.h"

namespace craftfleet {

// Whether updates correct their rollout with outputs of the weights that they start from, and where these come from:
// from the passes of the first epoch, or from a pass before the update.
enum class LagCorrection { kNone, kInFirstEpoch, kBefore };
LagCorrection LagCorrectionOf(const v1::PpoConfig& config);

GaeOptions GaeOptionsOf(const v1::PpoConfig& config);

// What these weights say about the rollout's steps. Before the update without dropout; in the first epoch each step has
// the outputs that it was learned from, of weights a few optimiser steps later.
struct StartOutputs {
  explicit StartOutputs(size_t n) : log_probs(n), values(n) {}
  std::vector<float> log_probs;  // [n] of the actions
  std::vector<float> values;     // [n] not normalised
};

struct CorrectedRollout {
  Rollout rollout;
  ImportanceStats importance;
};

// `rollout` as an update uses it; n > 0. With decoupled_objective the start's log-probabilities replace the rollout's,
// and the importance weights become Rollout::weights; with recompute_values the start's values replace the rollout's.
// With these or V-trace, advantages and returns are computed anew.
CorrectedRollout CorrectLag(const Rollout& rollout, const StartOutputs& start, const v1::PpoConfig& config);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_LAG_CORRECTION_H_
