#include "learner/ppo/rollout.h"

#include <algorithm>
#include <utility>

#include <absl/types/span.h>

namespace craftfleet {
namespace {

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

void AppendFragment(const Fragment& fragment, const RolloutOptions& options, Rollout* rollout) {
  for (size_t t = 0; t < fragment.actions.size(); ++t) {
    rollout->frames.push_back(reinterpret_cast<const uint8_t*>(fragment.frames.data()) + t * options.frame_bytes);
    rollout->actions.push_back(static_cast<Action>(fragment.actions[t]));
  }
  rollout->log_probs.insert(rollout->log_probs.end(), fragment.log_probs.begin(), fragment.log_probs.end());
  rollout->rewards.insert(rollout->rewards.end(), fragment.rewards.begin(), fragment.rewards.end());
  rollout->ends.insert(rollout->ends.end(), fragment.ends.begin(), fragment.ends.end());
  AppendStates(fragment, options, rollout);
  AppendAdvantages(fragment, options, rollout);
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
