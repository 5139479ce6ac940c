#include "learner/ppo/lag_correction.h"

#include <algorithm>
#include <cmath>

#include <absl/types/span.h>

#include "learner/ppo/ppo_loss.h"

namespace craftfleet {

LagCorrection LagCorrectionOf(const v1::PpoConfig& config) {
  const bool corrects = config.decoupled_objective() || config.recompute_values() || config.vtrace_rho_bar() > 0;
  if (!corrects) return LagCorrection::kNone;
  return config.correction_pass() || config.epochs() == 1 ? LagCorrection::kBefore : LagCorrection::kInFirstEpoch;
}

GaeOptions GaeOptionsOf(const v1::PpoConfig& config) {
  GaeOptions options;
  options.gamma = config.gamma();
  options.lambda = config.gae_lambda();
  options.truncation_is_terminal = config.truncation_is_terminal();
  options.rho_bar = config.vtrace_rho_bar();
  options.c_bar = config.vtrace_c_bar();
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
  if (config.recompute_values()) ReplaceValues(start.values, &corrected.rollout);
  const bool weighs = config.vtrace_rho_bar() > 0;
  if (config.recompute_values() || weighs) {
    EstimateAdvantages(GaeOptionsOf(config), weighs ? absl::MakeConstSpan(ratios) : absl::Span<const double>(),
                       &corrected.rollout);
  }
  if (config.decoupled_objective()) {
    corrected.rollout.log_probs = start.log_probs;
    corrected.rollout.weights.assign(ratios.begin(), ratios.end());
  }
  return corrected;
}

}  // namespace craftfleet
