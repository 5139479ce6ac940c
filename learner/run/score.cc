#include "learner/run/score.h"

#include <algorithm>
#include <cmath>

#include "learner/run/stats_log.h"

namespace craftfleet {
namespace {

constexpr size_t kRecentEpisodes = 100;

double Mean(double sum, int64_t count) { return count == 0 ? 0 : sum / static_cast<double>(count); }

}  // namespace

double CrafterScore(const AchievementPercentages& percentages) {
  double sum = 0;
  for (const double percentage : percentages) sum += std::log1p(percentage);
  return std::expm1(sum / kNumAchievements);
}

void ScoreBoard::Add(const Episode& episode) {
  const double reward = RoundReward(episode.reward);
  ++episodes_;
  reward_sum_ += reward;
  length_sum_ += episode.length;
  for (int i = 0; i < kNumAchievements; ++i) unlocked_in_[i] += episode.achievements[i] > 0 ? 1 : 0;
  recent_.emplace_back(reward, episode.length);
  if (recent_.size() > kRecentEpisodes) recent_.pop_front();
}

AchievementPercentages ScoreBoard::SuccessPercentages() const {
  AchievementPercentages percentages;
  for (int i = 0; i < kNumAchievements; ++i) percentages[i] = Mean(100.0 * unlocked_in_[i], episodes_);
  return percentages;
}

double ScoreBoard::MeanReward() const { return Mean(reward_sum_, episodes_); }

double ScoreBoard::MeanLength() const { return Mean(static_cast<double>(length_sum_), episodes_); }

int ScoreBoard::Unlocked() const {
  return std::count_if(unlocked_in_.begin(), unlocked_in_.end(), [](int64_t episodes) { return episodes > 0; });
}

double ScoreBoard::RecentReward() const {
  double sum = 0;
  for (const auto& [reward, length] : recent_) sum += reward;
  return Mean(sum, recent_.size());
}

double ScoreBoard::RecentLength() const {
  int64_t sum = 0;
  for (const auto& [reward, length] : recent_) sum += length;
  return Mean(static_cast<double>(sum), recent_.size());
}

}  // namespace craftfleet
