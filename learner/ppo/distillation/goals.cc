#include "learner/ppo/distillation/goals.h"

#include <algorithm>

namespace craftfleet {

std::vector<StepRange> WholeEpisodes(absl::Span<const uint8_t> is_start) {
  std::vector<StepRange> episodes;
  int first = -1;  // of the episode being read; -1: none has begun yet
  for (int t = 0; t < static_cast<int>(is_start.size()); ++t) {
    if (!is_start[t]) continue;
    if (first >= 0) episodes.push_back({first, t});
    first = t;
  }
  return episodes;
}

std::vector<int> GoalSteps(absl::Span<const uint8_t> unlocked) {
  std::vector<int> goals;
  for (int t = 0; t + 1 < static_cast<int>(unlocked.size()); ++t) {
    if (unlocked[t]) goals.push_back(t);
  }
  return goals;
}

FramePair NextGoal(absl::Span<const int> goals, int length, int t) {
  const auto* const next = std::lower_bound(goals.begin(), goals.end(), t);
  return next == goals.end() ? FramePair{length - 1, kNoFrame} : FramePair{*next, *next + 1};
}

}  // namespace craftfleet
