// Rollouts that older weights played: the decoupled objective (Hilton et al. 2021) and V-trace's weights (Espeholt et
// al. 2018). Equations: PPO.md, section 10.

#ifndef CRAFTFLEET_LEARNER_PPO_LAG_CORRECTION_H_
#define CRAFTFLEET_LEARNER_PPO_LAG_CORRECTION_H_

#include <absl/types/span.h>

#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/gae.h"
#include "learner/ppo/rollout.h"
#include "learner/ppo/update_stats.h"

namespace craftfleet {

// Whether updates need the log-probabilities of their rollout under the weights that they start from.
bool CorrectsLag(const v1::PpoConfig& config);

struct CorrectedRollout {
  Rollout rollout;
  ImportanceStats importance;
};

// `rollout` as an update uses it. `log_probs` [n] are those of its actions under the weights that the update starts
// from, n > 0. With the decoupled objective they replace the rollout's, and the importance weights become
// Rollout::weights; with V-trace, advantages and returns are computed anew, with `gae` (RolloutOptions::gae).
CorrectedRollout CorrectLag(const Rollout& rollout, absl::Span<const float> log_probs, const v1::PpoConfig& config,
                            const GaeOptions& gae);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_LAG_CORRECTION_H_
