// The score of a run: Crafter's score (Hafner 2021) and the means for its learning curve.
// Formula: FORMATS.md, section 6; golden: tests/data/agents/score.json.

#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <utility>

#include "common/base/crafter.h"
#include "common/base/types.h"

namespace craftfleet {

using AchievementPercentages = std::array<double, kNumAchievements>;  // 0..100, in the order of kAchievementNames

// exp(mean of ln(1 + percentage)) - 1 over the 22 achievements; 0..100.
double CrafterScore(const AchievementPercentages& percentages);

// Sums up finished episodes. Rewards are rounded to one decimal, so that a board rebuilt from stats.jsonl is equal.
// Thread-compatible: one thread at a time.
class ScoreBoard {
 public:
  void Add(const Episode& episode);

  int64_t episodes() const { return episodes_; }

  // Over all episodes; 0 if there are none.
  AchievementPercentages SuccessPercentages() const;  // of episodes that unlocked each at least once
  double Score() const { return CrafterScore(SuccessPercentages()); }
  double MeanReward() const;
  double MeanLength() const;
  int Unlocked() const;  // achievements unlocked in at least one episode; 0..22

  // Means of the last 100 episodes, or of all if fewer; 0 if there are none.
  double RecentReward() const;
  double RecentLength() const;

 private:
  int64_t episodes_ = 0;
  double reward_sum_ = 0;
  int64_t length_sum_ = 0;
  std::array<int64_t, kNumAchievements> unlocked_in_{};  // number of episodes
  std::deque<std::pair<double, int64_t>> recent_;        // reward, length
};

}  // namespace craftfleet
