#include "learner/ppo/device_adam.h"

#include <cmath>

#include <ATen/ATen.h>
#include <c10/core/GradMode.h>
#include <torch/version.h>

#include "common/agent/policy_net.h"

namespace craftfleet {
namespace {

// LibTorch has Adam's whole step as one computation: on the CPU, where tests compare it, from 2.4 on.
constexpr bool kIsFused = TORCH_VERSION_MAJOR > 2 || (TORCH_VERSION_MAJOR == 2 && TORCH_VERSION_MINOR >= 4);

// double[]: the norm in float32 of each 65,536 numbers, then of these in double. In one step LibTorch would copy all of
// them to double.
at::Tensor NormOf(const at::Tensor& values) {
  constexpr int64_t kRow = 65536;
  const int64_t rows = values.numel() / kRow;
  const at::Tensor whole = values.narrow(0, 0, rows * kRow).view({rows, kRow});
  const at::Tensor rest = values.narrow(0, rows * kRow, values.numel() - rows * kRow).unsqueeze(0);
  const auto norms = [](const at::Tensor& table) { return at::linalg_vector_norm(table, 2, at::IntArrayRef({1})); };
  return at::linalg_vector_norm(at::cat({norms(whole), norms(rest)}).to(at::kDouble), 2);
}

}  // namespace

void DeviceAdam::Load(const AdamState& state, at::Device device) {
  exp_avg_ = SendFloats(state.exp_avg, device);
  exp_avg_sq_ = SendFloats(state.exp_avg_sq, device);
  steps_ = state.steps;
  if (kIsFused) device_steps_ = at::full({}, static_cast<double>(steps_), exp_avg_.options());
  kept_avg_ = at::empty_like(exp_avg_);
  kept_avg_sq_ = at::empty_like(exp_avg_sq_);
  Keep();
}

void DeviceAdam::Keep() {
  kept_avg_.copy_(exp_avg_);
  kept_avg_sq_.copy_(exp_avg_sq_);
  kept_steps_ = steps_;
}

void DeviceAdam::Undo() {
  exp_avg_.copy_(kept_avg_);
  exp_avg_sq_.copy_(kept_avg_sq_);
  steps_ = kept_steps_;
  if (kIsFused) device_steps_.fill_(static_cast<double>(steps_));
}

at::Tensor DeviceAdam::Step(const at::Tensor& gradient, const at::Tensor& weights) {
  const c10::NoGradGuard no_grad;
  at::Tensor norm = NormOf(gradient);
  const int64_t count = gradient.numel();
  const Parts parts = {gradient, weights.narrow(0, 0, count), exp_avg_.narrow(0, 0, count),
                       exp_avg_sq_.narrow(0, 0, count)};
  ++steps_;
  kIsFused ? StepFused(parts, norm) : StepApart(parts, norm);
  return norm;
}

void DeviceAdam::StepFused(const Parts& parts, const at::Tensor& norm) {
  device_steps_.add_(1);
  // The gradient is divided by it.
  const at::Tensor scale = ((norm + 1e-6) / config_.max_gradient_norm()).clamp_min(1).to(at::kFloat);
  at::_fused_adam_({parts.weights}, {parts.gradient}, {parts.exp_avg}, {parts.exp_avg_sq}, {}, {device_steps_},
                   config_.learning_rate(), kAdamBeta1, kAdamBeta2, /*weight_decay=*/0, config_.adam_epsilon(),
                   /*amsgrad=*/false, /*maximize=*/false, scale);
}

void DeviceAdam::StepApart(const Parts& parts, const at::Tensor& norm) {
  const auto& [gradient, weights, exp_avg, exp_avg_sq] = parts;
  gradient.mul_((config_.max_gradient_norm() / (norm + 1e-6)).clamp_max(1).to(at::kFloat));
  const auto t = static_cast<double>(steps_);
  exp_avg.mul_(kAdamBeta1).add_(gradient, 1 - kAdamBeta1);
  exp_avg_sq.mul_(kAdamBeta2).addcmul_(gradient, gradient, 1 - kAdamBeta2);
  const at::Tensor divisor =
      exp_avg_sq.sqrt().mul_(1 / std::sqrt(1 - std::pow(kAdamBeta2, t))).add_(config_.adam_epsilon());
  weights.addcdiv_(exp_avg, divisor, -config_.learning_rate() / (1 - std::pow(kAdamBeta1, t)));
}

}  // namespace craftfleet
