#include "learner/ppo/rollout.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/types/span.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

absl::Status CheckFragment(const Fragment& fragment, const RolloutOptions& options) {
  const size_t steps = fragment.actions.size();
  if (steps == 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("fragment ", fragment.number, " of lane ", fragment.lane, " has no steps"));
  }
  const auto has = [&](absl::string_view field, size_t size, size_t want) {
    if (size == want) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrCat("fragment ", fragment.number, " of lane ", fragment.lane, ": ", size,
                                                   " ", field, " for ", steps, " steps, want ", want));
  };
  CRAFTFLEET_RETURN_IF_ERROR(has("bytes of frames", fragment.frames.size(), steps * options.frame_bytes));
  CRAFTFLEET_RETURN_IF_ERROR(has("log_probs", fragment.log_probs.size(), steps));
  CRAFTFLEET_RETURN_IF_ERROR(has("values", fragment.values.size(), steps));
  CRAFTFLEET_RETURN_IF_ERROR(has("rewards", fragment.rewards.size(), steps));
  CRAFTFLEET_RETURN_IF_ERROR(has("ends", fragment.ends.size(), steps));
  const size_t truncations = std::count(fragment.ends.begin(), fragment.ends.end(), StepEnd::kTruncated);
  CRAFTFLEET_RETURN_IF_ERROR(has("truncation_values", fragment.truncation_values.size(), truncations));
  const size_t states = options.every_state ? steps : 1;
  CRAFTFLEET_RETURN_IF_ERROR(has("numbers of states", fragment.states.size(), states * options.state_size));
  for (const char action : fragment.actions) {
    const int number = static_cast<unsigned char>(action);
    if (number >= kNumActions) {
      return absl::InvalidArgumentError(absl::StrCat("fragment ", fragment.number, " of lane ", fragment.lane,
                                                     ": action ", number, ", want 0..", kNumActions - 1));
    }
  }
  return absl::OkStatus();
}

// How the fragment's step `t` relates to the row before it.
RowStart StartOf(const Fragment& fragment, size_t t, const Rollout& rollout) {
  if (t > 0) return fragment.ends[t - 1] == StepEnd::kNone ? RowStart::kNone : RowStart::kEpisode;
  if (fragment.lane != rollout.last_lane) return RowStart::kLane;
  return rollout.last_end == StepEnd::kNone ? RowStart::kFragment : RowStart::kEpisode;
}

void AppendStates(const Fragment& fragment, const RolloutOptions& options, Rollout* rollout) {
  for (size_t t = 0; t < fragment.actions.size(); ++t) {
    rollout->starts.push_back(StartOf(fragment, t, *rollout));
    const bool kept = options.state_size > 0 && (t == 0 || options.every_state);
    rollout->states.push_back(kept ? &fragment.states[t * options.state_size] : nullptr);
  }
  rollout->last_lane = fragment.lane;
  rollout->last_end = fragment.ends.back();
}

// Writes the advantages and returns of the rollout's rows in `fragment`.
void EstimateFragment(const RolloutFragment& fragment, const GaeOptions& options, Rollout* rollout) {
  const auto rows = [&](const auto& column) {
    return absl::MakeConstSpan(column).subspan(fragment.first, fragment.steps);
  };
  const LaneSteps steps = {rows(rollout->rewards), rows(rollout->values), rows(rollout->ends),
                           fragment.truncation_values, fragment.bootstrap_value};
  ComputeGae(steps, options, absl::MakeSpan(rollout->advantages).subspan(fragment.first, fragment.steps),
             absl::MakeSpan(rollout->returns).subspan(fragment.first, fragment.steps));
}

// Denormalised values, and the advantages and returns computed from them.
void AppendAdvantages(const Fragment& fragment, const RolloutOptions& options, Rollout* rollout) {
  const ValueScale& scale = options.value_scale;
  RolloutFragment& added = rollout->fragments.emplace_back();
  added.first = rollout->values.size();
  added.steps = fragment.values.size();
  added.bootstrap_value = scale.Denormalise(fragment.bootstrap_value);
  for (const float value : fragment.truncation_values) added.truncation_values.push_back(scale.Denormalise(value));
  for (const float value : fragment.values) rollout->values.push_back(scale.Denormalise(value));
  rollout->advantages.resize(rollout->values.size());
  rollout->returns.resize(rollout->values.size());
  EstimateFragment(added, options.gae, rollout);
}

}  // namespace

absl::Status AppendFragment(const Fragment& fragment, const RolloutOptions& options, Rollout* rollout) {
  CRAFTFLEET_RETURN_IF_ERROR(CheckFragment(fragment, options));
  for (size_t t = 0; t < fragment.actions.size(); ++t) {
    rollout->frames.push_back(reinterpret_cast<const uint8_t*>(fragment.frames.data()) + t * options.frame_bytes);
    rollout->actions.push_back(static_cast<Action>(fragment.actions[t]));
  }
  rollout->log_probs.insert(rollout->log_probs.end(), fragment.log_probs.begin(), fragment.log_probs.end());
  rollout->rewards.insert(rollout->rewards.end(), fragment.rewards.begin(), fragment.rewards.end());
  rollout->ends.insert(rollout->ends.end(), fragment.ends.begin(), fragment.ends.end());
  AppendStates(fragment, options, rollout);
  AppendAdvantages(fragment, options, rollout);
  return absl::OkStatus();
}

void ReplaceValues(std::vector<float> values, Rollout* rollout) {
  rollout->values = std::move(values);
  for (RolloutFragment& fragment : rollout->fragments) {
    const size_t after = fragment.first + fragment.steps;
    const bool is_there = after < rollout->size() && rollout->starts[after] == RowStart::kFragment;
    if (is_there) fragment.bootstrap_value = rollout->values[after];
  }
}

void EstimateAdvantages(const GaeOptions& options, Rollout* rollout) {
  for (const RolloutFragment& fragment : rollout->fragments) EstimateFragment(fragment, options, rollout);
}

}  // namespace craftfleet
