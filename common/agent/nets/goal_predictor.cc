#include "common/agent/nets/goal_predictor.h"

#include <vector>

#include <ATen/ATen.h>

#include "common/base/crafter.h"

namespace craftfleet {
namespace {

// Row norms at the start, of the first and the second layer.
constexpr double kFirstNorm = 1.4;
constexpr double kSecondNorm = 1;

}  // namespace

GoalPredictor::GoalPredictor(int64_t features, int64_t memory, ParamList* params)
    : has_memory_(memory > 0),
      film0_("film.linear0", kNumActions, features, kFirstNorm, params),
      film1_("film.linear1.layer", features, 2 * features, RowNorm(kSecondNorm), Bias::kZero, params),
      predictor0_("predictor.linear0", features + memory, features, kFirstNorm, params),
      predictor1_("predictor.linear1.layer", features, features, RowNorm(kSecondNorm), Bias::kZero, params) {}

at::Tensor GoalPredictor::Forward(const ParamTensors& params, const at::Tensor& features, const at::Tensor& actions,
                                  const at::Tensor& memory) const {
  const std::vector<at::Tensor> film = film1_.Forward(params, film0_.Forward(params, actions)).chunk(2, 1);
  at::Tensor input = (film[0] + 1) * features + film[1];
  if (has_memory_) input = at::cat({input, memory}, 1);
  return predictor1_.Forward(params, predictor0_.Forward(params, input));
}

}  // namespace craftfleet
