#include "learner/ppo/device_loss.h"

#include <algorithm>
#include <cstdint>

#include <ATen/ATen.h>

#include "common/base/crafter.h"

namespace craftfleet {

// No gather, whose gradient a GPU adds in any order.
at::Tensor ChosenActions(const at::Tensor& actions) {
  return actions.unsqueeze(1).eq(at::arange(int64_t{kNumActions}, actions.options())).to(at::kDouble);
}

DeviceLoss PpoLossOnDevice(const at::Tensor& logits, const at::Tensor& values, const DeviceTargets& targets,
                           const v1::PpoConfig& config) {
  const auto rows = static_cast<double>(values.size(0));
  const at::Tensor log_probs = logits.to(at::kDouble).log_softmax(1);
  const at::Tensor probs = log_probs.exp();
  const at::Tensor chosen = ChosenActions(targets.actions);
  const at::Tensor advantages = targets.advantages.to(at::kDouble);
  const at::Tensor log_ratio = ((log_probs * chosen).sum(1) - targets.log_probs).clamp_max(kMaxLogRatio);
  const at::Tensor ratio = log_ratio.exp();
  const at::Tensor plain = advantages * ratio;
  const at::Tensor clipped = advantages * ratio.clamp(1 - config.clip(), 1 + config.clip());
  const at::Tensor entropy = -(probs * log_probs).sum(1);
  const at::Tensor value_error = (values - targets.returns).to(at::kDouble);

  // As in PpoLoss: the clamp is flat outside its range, where the minimum may choose it.
  const at::Tensor by_log_prob = at::where(plain.le(clipped), -plain, at::zeros_like(plain)).unsqueeze(1);
  const at::Tensor by_policy = by_log_prob * (chosen - probs);
  const at::Tensor by_entropy = -probs * (log_probs + entropy.unsqueeze(1));
  DeviceLoss loss;
  loss.by_logits = ((by_policy - by_entropy * config.entropy_coefficient()) / rows).to(at::kFloat);
  loss.by_values = (value_error * (2 * config.value_coefficient() / rows)).to(at::kFloat);
  loss.means = at::stack({-at::minimum(plain, clipped), value_error.square(), entropy, (ratio - 1) - log_ratio,
                          (ratio - 1).abs().gt(config.clip()).to(at::kDouble)})
                   .mean(1);
  return loss;
}

at::Tensor NormaliseOnDevice(const at::Tensor& advantages) {
  const at::Tensor values = advantages.to(at::kDouble);
  const at::Tensor centred = values - values.mean();
  const auto degrees = static_cast<double>(std::max<int64_t>(values.size(0) - 1, 1));
  const at::Tensor deviation = (centred.square().sum() / degrees).sqrt();
  return (centred / (deviation + 1e-8)).to(at::kFloat);
}

}  // namespace craftfleet
