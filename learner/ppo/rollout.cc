#include "learner/ppo/rollout.h"

#include <algorithm>

#include <absl/strings/str_cat.h>
#include <absl/types/span.h>

#include "common/status_macros.h"

namespace craftfleet {
namespace {

absl::Status CheckFragment(const Fragment& fragment, int64_t frame_bytes) {
  const size_t steps = fragment.actions.size();
  const auto has = [&](absl::string_view field, size_t size, size_t want) {
    if (size == want) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrCat("fragment ", fragment.number, " of lane ", fragment.lane, ": ", size,
                                                   " ", field, " for ", steps, " steps, want ", want));
  };
  CRAFTFLEET_RETURN_IF_ERROR(has("bytes of frames", fragment.frames.size(), steps * frame_bytes));
  CRAFTFLEET_RETURN_IF_ERROR(has("log_probs", fragment.log_probs.size(), steps));
  CRAFTFLEET_RETURN_IF_ERROR(has("values", fragment.values.size(), steps));
  CRAFTFLEET_RETURN_IF_ERROR(has("rewards", fragment.rewards.size(), steps));
  CRAFTFLEET_RETURN_IF_ERROR(has("ends", fragment.ends.size(), steps));
  const size_t truncations = std::count(fragment.ends.begin(), fragment.ends.end(), StepEnd::kTruncated);
  CRAFTFLEET_RETURN_IF_ERROR(has("truncation_values", fragment.truncation_values.size(), truncations));
  for (const char action : fragment.actions) {
    const int number = static_cast<unsigned char>(action);
    if (number >= kNumActions) {
      return absl::InvalidArgumentError(absl::StrCat("fragment ", fragment.number, " of lane ", fragment.lane,
                                                     ": action ", number, ", want 0..", kNumActions - 1));
    }
  }
  return absl::OkStatus();
}

}  // namespace

absl::Status AppendFragment(const Fragment& fragment, int64_t frame_bytes, const GaeOptions& gae, Rollout* rollout) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckFragment(fragment, frame_bytes));
  const size_t first = rollout->size();
  const size_t steps = fragment.actions.size();
  for (size_t t = 0; t < steps; ++t) {
    rollout->frames.push_back(reinterpret_cast<const uint8_t*>(fragment.frames.data()) + t * frame_bytes);
    rollout->actions.push_back(static_cast<Action>(fragment.actions[t]));
  }
  rollout->log_probs.insert(rollout->log_probs.end(), fragment.log_probs.begin(), fragment.log_probs.end());
  rollout->values.insert(rollout->values.end(), fragment.values.begin(), fragment.values.end());
  rollout->advantages.resize(first + steps);
  rollout->returns.resize(first + steps);
  ComputeGae({fragment.rewards, fragment.values, fragment.ends, fragment.truncation_values, fragment.bootstrap_value},
             gae, absl::MakeSpan(rollout->advantages).subspan(first), absl::MakeSpan(rollout->returns).subspan(first));
  return absl::OkStatus();
}

}  // namespace craftfleet
