// Which steps of an episode unlocked something, and which of them comes next (Moon et al. 2023). No LibTorch.

#ifndef CRAFTFLEET_LEARNER_PPO_DISTILLATION_GOALS_H_
#define CRAFTFLEET_LEARNER_PPO_DISTILLATION_GOALS_H_

#include <cstdint>
#include <vector>

#include <absl/types/span.h>

namespace craftfleet {

// Consecutive steps of one lane: first..end-1.
struct StepRange {
  int first = 0;
  int end = 0;
  friend bool operator==(const StepRange& a, const StepRange& b) { return a.first == b.first && a.end == b.end; }
};

// The episodes that begin and end within a lane's kept steps. `is_start[t]`: step t is the first of an episode. What
// comes before the first start and after the last one belongs to episodes that are not whole.
std::vector<StepRange> WholeEpisodes(absl::Span<const uint8_t> is_start);

// The steps of an episode that unlocked an achievement, ascending. An unlock by the last step is none: no frame of the
// episode shows its effect.
std::vector<int> GoalSteps(absl::Span<const uint8_t> unlocked);

constexpr int kNoFrame = -1;

// Two frames of an episode, by step, whose features differ by an achievement.
struct FramePair {
  int before = 0;
  int after = 0;  // kNoFrame: nothing comes
};

// What step t, 0..length-1, should foresee: the next goal, its own included; after the last one, the end of the
// episode.
FramePair NextGoal(absl::Span<const int> goals, int length, int t);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_DISTILLATION_GOALS_H_
