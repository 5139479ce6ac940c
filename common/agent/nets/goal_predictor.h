// Predicts how the features will change at the next achievement (Moon et al. 2023). Does not include LibTorch.

#pragma once

#include <cstdint>

#include <ATen/core/ATen_fwd.h>
#include <absl/strings/match.h>
#include <absl/strings/string_view.h>

#include "common/agent/nets/layers.h"

namespace craftfleet {

// The action scales and shifts the features (FiLM): film.linear0 (17 -> F, normalised input, no bias, ReLU) and
// film.linear1 (F -> 2F, with bias) turn the action, as a one-hot vector, into a scale g and a shift b of each feature:
// (1 + g) * features + b. predictor.linear0 (2F -> F, normalised input, no bias, ReLU; F -> F without a memory) sees
// that and the memory, predictor.linear1 (F -> F, with bias) makes the prediction. Trained by distillation alone;
// acting does not need it.
class GoalPredictor {
 public:
  // For `features` features and a memory of `memory` floats; 0: none. Parameters: film.*, predictor.*.
  GoalPredictor(int64_t features, int64_t memory, ParamList* params);

  // features float[N,F], actions float[N,17] (1 at the action, else 0), memory float[N,M], ignored without a memory ->
  // float[N,F], not scaled to length 1.
  at::Tensor Forward(const ParamTensors& params, const at::Tensor& features, const at::Tensor& actions,
                     const at::Tensor& memory) const;

 private:
  const bool has_memory_;
  NormedLinear film0_;
  LinearLayer film1_;  // to scale - 1 and shift of each feature
  NormedLinear predictor0_;
  LinearLayer predictor1_;
};

// Whether a parameter of this name is one of these layers', which PPO does not train.
inline bool IsOfGoalPredictor(absl::string_view param) {
  return absl::StartsWith(param, "film.") || absl::StartsWith(param, "predictor.");
}

}  // namespace craftfleet
