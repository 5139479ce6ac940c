#include "learner/ppo/divergence.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include <ATen/ATen.h>
#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

namespace craftfleet {
namespace {

constexpr size_t kMaxTrialSteps = 64;
constexpr absl::string_view kRemedy = "a smaller ppo.learning_rate may help";

}  // namespace

Minibatch TrialSteps(const Rollout& rollout, bool has_segments) {
  Minibatch steps;
  steps.rows.push_back(0);
  for (size_t row = 1; row < rollout.starts.size() && steps.rows.size() < kMaxTrialSteps; ++row) {
    if (rollout.starts[row] != RowStart::kNone) steps.rows.push_back(static_cast<int>(row));
  }
  if (has_segments) steps.lengths.assign(steps.rows.size(), 1);
  return steps;
}

absl::Status CheckGradient(double norm, int64_t step) {
  if (std::isfinite(norm)) return absl::OkStatus();
  return absl::DataLossError(
      absl::StrFormat("training diverges: the gradient's norm is %g at optimiser step %d; %s", norm, step, kRemedy));
}

at::Tensor LargestOutputs(const NetOutput& output) {
  return at::stack({output.values.abs().max(), output.logits.abs().max()});
}

absl::Status CheckOutputs(float largest_value, float largest_logit, const ValueRange& accepts) {
  const double most = std::min(-accepts.low, accepts.high) / 10;
  if (largest_value <= most && std::isfinite(largest_logit)) return absl::OkStatus();
  return absl::DataLossError(absl::StrFormat(
      "training diverges: the new weights' values reach %g and their logits %g, want values up to %g and "
      "finite logits; %s",
      largest_value, largest_logit, most, kRemedy));
}

}  // namespace craftfleet
