#include "learner/ppo/distillation/device_losses.h"

#include <algorithm>
#include <cstdint>

#include <ATen/ATen.h>

#include "learner/ppo/device_rollout.h"
#include "learner/ppo/distillation/kept_rollouts.h"

namespace craftfleet {
namespace {

// Vectors double[k,F] scaled to length 1; those of length 0 stay 0.
struct Units {
  explicit Units(const at::Tensor& vectors) {
    const at::Tensor lengths = vectors.square().sum(1, /*keepdim=*/true).sqrt();
    inverse = at::where(lengths.gt(0), lengths.reciprocal(), at::zeros_like(lengths));
    values = vectors * inverse;
  }

  // The gradient by the vectors, given that by `values`.
  at::Tensor Gradient(const at::Tensor& by_values) const {
    return (by_values - (values * by_values).sum(1, /*keepdim=*/true) * values) * inverse;
  }

  at::Tensor values;
  at::Tensor inverse;  // double[k,1] of their lengths; 0 for 0
};

// double[n,k]: 1 where `places`, int64[k], has the row. The product with it adds vectors by place, in a fixed order.
at::Tensor OneHot(const at::Tensor& places, int64_t rows) {
  return at::arange(rows, places.options()).unsqueeze(1).eq(places.unsqueeze(0)).to(at::kDouble);
}

// ContrastiveLoss of the step. Sets losses->by_features, and returns the mean: double[].
at::Tensor ContrastiveLossOnDevice(const DeviceStep& step, const NetOutput& output, const at::Tensor& changes,
                                   DeviceStepLosses* losses) {
  const bool predicts = step.loss == DistillationLoss::kPrediction;
  const at::Tensor codes = output.codes.detach().to(at::kDouble);
  const at::Tensor padded = at::cat({codes, at::zeros_like(codes.narrow(0, 0, 1))});
  const at::Tensor others = (predicts ? output.predictions.detach() : changes).to(at::kDouble);
  const Units anchor(padded.index_select(0, step.after) - padded.index_select(0, step.before));
  const Units positive(others.index_select(0, step.positive));
  const Units negative(others.index_select(0, step.negative));
  const at::Tensor difference = negative.values - positive.values;
  const at::Tensor excess = (anchor.values * difference).sum(1, /*keepdim=*/true) / step.temperature;
  const at::Tensor factor = excess.sigmoid() / (step.temperature * static_cast<double>(excess.size(0)));
  const int64_t rows = codes.size(0);
  const at::Tensor gradient =
      predicts ? at::mm(OneHot(step.negative, rows), negative.Gradient(factor * anchor.values)) -
                     at::mm(OneHot(step.positive, rows), positive.Gradient(factor * anchor.values))
               : at::mm(OneHot(step.after, rows) - OneHot(step.before, rows), anchor.Gradient(factor * difference));
  losses->by_features = gradient.to(at::kFloat);
  return at::softplus(excess).mean();
}

}  // namespace

DeviceStep SendStep(const DistillationStep& step, at::Device device) {
  const auto rows = static_cast<int64_t>(step.rows.size());
  const auto contrasts = static_cast<int64_t>(step.contrasts.size());
  const at::Tensor places = HostTensor({rows + 4 * contrasts}, at::kLong, device);
  auto* next = std::copy(step.rows.begin(), step.rows.end(), places.data_ptr<int64_t>());
  for (const Contrast& contrast : step.contrasts) *next++ = contrast.before;
  for (const Contrast& contrast : step.contrasts) *next++ = contrast.after == kNoFrame ? rows : contrast.after;
  for (const Contrast& contrast : step.contrasts) *next++ = contrast.positive;
  for (const Contrast& contrast : step.contrasts) *next++ = contrast.negative;
  const at::Tensor numbers = HostTensor({2, rows}, at::kDouble, device);
  std::copy(step.targets.begin(), step.targets.end(),
            std::copy(step.weights.begin(), step.weights.end(), numbers.data_ptr<double>()));
  const at::Tensor there = places.to(device, /*non_blocking=*/true);
  const at::Tensor numbers_there = numbers.to(device, /*non_blocking=*/true);
  const auto part = [&](int64_t i) { return there.narrow(0, rows + i * contrasts, contrasts); };
  return {step.loss, step.temperature,           there.narrow(0, 0, rows),  part(0), part(1), part(2),
          part(3),   numbers_there.select(0, 0), numbers_there.select(0, 1)};
}

DeviceStepLosses StepLossesOnDevice(const DeviceStep& step, const NetOutput& output, const at::Tensor& changes,
                                    const at::Tensor& old_log_probs) {
  DeviceStepLosses losses;
  const at::Tensor contrastive = ContrastiveLossOnDevice(step, output, changes, &losses);
  const at::Tensor log_probs = output.logits.detach().to(at::kDouble).log_softmax(1);
  const at::Tensor probs = log_probs.exp();
  const at::Tensor change = log_probs - old_log_probs;
  const at::Tensor divergence = (probs * change).sum(1, /*keepdim=*/true);
  losses.by_logits = (step.weights.unsqueeze(1) * probs * (change - divergence)).to(at::kFloat);
  const at::Tensor error = output.values.detach().to(at::kDouble) - step.targets;
  losses.by_values = (2 * step.weights * error).to(at::kFloat);
  losses.means =
      at::stack({contrastive, (step.weights * divergence.squeeze(1)).sum(), (step.weights * error.square()).sum()});
  return losses;
}

}  // namespace craftfleet
