#include "deploy/cli/eval/eval_result.h"

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <nlohmann/json.hpp>

#include "common/base/crafter.h"

namespace craftfleet {

std::string DescribeResult(const ScoreBoard& board) {
  std::string text;
  const AchievementPercentages percentages = board.SuccessPercentages();
  for (int i = 0; i < kNumAchievements; ++i) {
    absl::StrAppendFormat(&text, "%-20s %5.1f%%\n", kAchievementNames[i], percentages[i]);
  }
  absl::StrAppendFormat(
      &text, "\nepisodes %d   reward %.2f   length %.1f   achievements unlocked %d/22   Crafter score %.2f\n",
      board.episodes(), board.MeanReward(), board.MeanLength(), board.Unlocked(), board.Score());
  return text;
}

void AddResult(const ScoreBoard& board, nlohmann::ordered_json* json) {
  (*json)["episodes"] = board.episodes();
  (*json)["reward"] = board.MeanReward();
  (*json)["length"] = board.MeanLength();
  (*json)["score"] = board.Score();
  const AchievementPercentages percentages = board.SuccessPercentages();
  for (int i = 0; i < kNumAchievements; ++i) {
    const std::string name(kAchievementNames[i]);
    (*json)["success_percentages"][name] = percentages[i];
  }
}

}  // namespace craftfleet
