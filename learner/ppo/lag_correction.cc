#include "learner/ppo/lag_correction.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "learner/ppo/ppo_loss.h"

namespace craftfleet {

bool CorrectsLag(const v1::PpoConfig& config) { return config.decoupled_objective() || config.vtrace_rho_bar() > 0; }

CorrectedRollout CorrectLag(const Rollout& rollout, absl::Span<const float> log_probs, const v1::PpoConfig& config,
                            const GaeOptions& gae) {
  std::vector<double> ratios;
  double sum = 0;
  for (size_t row = 0; row < rollout.size(); ++row) {
    ratios.push_back(std::exp(std::min(double{log_probs[row]} - rollout.log_probs[row], kMaxLogRatio)));
    sum += ratios.back();
  }
  const auto [min, max] = std::minmax_element(ratios.begin(), ratios.end());
  CorrectedRollout corrected = {rollout, {sum / static_cast<double>(ratios.size()), *min, *max}};
  if (config.vtrace_rho_bar() > 0) EstimateAdvantages(gae, ratios, &corrected.rollout);
  if (config.decoupled_objective()) {
    corrected.rollout.log_probs.assign(log_probs.begin(), log_probs.end());
    corrected.rollout.weights.assign(ratios.begin(), ratios.end());
  }
  return corrected;
}

}  // namespace craftfleet
