#include "learner/ppo/lag_correction.h"

#include <algorithm>
#include <cmath>

#include "learner/ppo/ppo_loss.h"

namespace craftfleet {

bool CorrectsLag(const v1::RunConfig& config, const v1::NetworkConfig& network) {
  const bool lags = config.overlap() > 0 || config.max_staleness() > 0;
  const bool has_dropout = network.objects() != v1::NetworkConfig::NO_OBJECTS && network.dropout() > 0;
  return lags && config.ppo().epochs() > 1 && !has_dropout;
}

GaeOptions GaeOptionsOf(const v1::PpoConfig& config) {
  GaeOptions options;
  options.gamma = config.gamma();
  options.lambda = config.gae_lambda();
  options.truncation_is_terminal = config.truncation_is_terminal();
  return options;
}

CorrectedRollout CorrectLag(const Rollout& rollout, const StartOutputs& start, const v1::PpoConfig& config) {
  std::vector<double> ratios;
  double sum = 0;
  for (size_t row = 0; row < rollout.size(); ++row) {
    ratios.push_back(std::exp(std::min(double{start.log_probs[row]} - rollout.log_probs[row], kMaxLogRatio)));
    sum += ratios.back();
  }
  const auto [min, max] = std::minmax_element(ratios.begin(), ratios.end());
  CorrectedRollout corrected = {rollout, {sum / static_cast<double>(ratios.size()), *min, *max}};
  ReplaceValues(start.values, &corrected.rollout);
  EstimateAdvantages(GaeOptionsOf(config), &corrected.rollout);
  corrected.rollout.log_probs = start.log_probs;
  corrected.rollout.weights.assign(ratios.begin(), ratios.end());
  return corrected;
}

}  // namespace craftfleet
