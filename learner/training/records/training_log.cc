#include "learner/training/records/training_log.h"

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/crafter.h"

namespace craftfleet {
namespace {

// The distributions of what was played.
std::vector<Histogram> RolloutHistograms(const std::vector<Fragment>& fragments) {
  Histogram actions = {"rollout/actions", {}};
  Histogram rewards = {"rollout/rewards", {}};
  Histogram values = {"rollout/values", {}};
  Histogram log_probs = {"rollout/log_probs", {}};
  for (const Fragment& fragment : fragments) {
    for (const char action : fragment.actions) actions.values.push_back(static_cast<uint8_t>(action));
    rewards.values.insert(rewards.values.end(), fragment.rewards.begin(), fragment.rewards.end());
    values.values.insert(values.values.end(), fragment.values.begin(), fragment.values.end());
    log_probs.values.insert(log_probs.values.end(), fragment.log_probs.begin(), fragment.log_probs.end());
  }
  return {std::move(actions), std::move(rewards), std::move(values), std::move(log_probs)};
}

}  // namespace

void TrainingLog::AddIteration(int64_t env_steps, const std::vector<Fragment>& fragments, const UpdateStats& stats,
                               double steps_per_second) {
  for (const Fragment& fragment : fragments) folder_->AddEpisodes(fragment.episodes);
  const ScoreBoard& score = folder_->score();
  std::vector<Scalar> scalars = {
      {"train/policy_loss", stats.policy_loss},
      {"train/value_loss", stats.value_loss},
      {"train/entropy", stats.entropy},
      {"train/approx_kl", stats.approx_kl},
      {"train/clip_fraction", stats.clip_fraction},
      {"train/gradient_norm", stats.gradient_norm},
      {"train/explained_variance", stats.explained_variance},
      {"rollout/reward", score.RecentReward()},
      {"rollout/length", score.RecentLength()},
      {"rollout/crafter_score", score.Score()},
      {"rollout/achievements_unlocked", static_cast<double>(score.Unlocked())},
      {"rollout/episodes", static_cast<double>(score.episodes())},
      {"time/steps_per_second", steps_per_second},
  };
  if (stats.importance.has_value()) {
    scalars.insert(scalars.end(), {{"train/importance_weight_mean", stats.importance->mean},
                                   {"train/importance_weight_min", stats.importance->min},
                                   {"train/importance_weight_max", stats.importance->max}});
  }
  if (stats.distillation.has_value()) {
    const DistillationStats& phase = *stats.distillation;
    scalars.insert(scalars.end(), {{"distillation/matching_loss", phase.matching_loss},
                                   {"distillation/prediction_loss", phase.prediction_loss},
                                   {"distillation/divergence", phase.divergence},
                                   {"distillation/value_loss", phase.value_loss},
                                   {"distillation/matching_steps", static_cast<double>(phase.matching_steps)},
                                   {"distillation/prediction_steps", static_cast<double>(phase.prediction_steps)},
                                   {"distillation/episodes", static_cast<double>(phase.episodes)}});
  }
  const AchievementPercentages percentages = score.SuccessPercentages();
  for (int i = 0; i < kNumAchievements; ++i) {
    scalars.push_back({absl::StrCat("success_rate/", kAchievementNames[i]), percentages[i]});
  }
  folder_->AddScalars(env_steps, scalars);
  folder_->AddHistograms(env_steps, RolloutHistograms(fragments));
}

void TrainingLog::AddStaleness(int64_t env_steps, const Staleness& staleness, int64_t dropped) {
  folder_->AddScalars(env_steps, {{"rollout/staleness_min", static_cast<double>(staleness.min)},
                                  {"rollout/staleness_mean", staleness.mean},
                                  {"rollout/staleness_max", static_cast<double>(staleness.max)},
                                  {"rollout/fragments_dropped", static_cast<double>(dropped)}});
}

void TrainingLog::Flush() {
  for (absl::Status status = folder_->FlushLogs(); !status.ok(); status = folder_->FlushLogs()) {
    if (absl::IsAborted(status)) return;  // another learner has taken over
    const std::string waiting = absl::StrFormat("%d bytes of logs are waiting for %s", folder_->waiting_bytes(),
                                                absl::IsResourceExhausted(status) ? "space" : "the disk");
    if (folder_->waiting_bytes() < max_waiting_bytes_) {
      disk_->Report(status, waiting);
      return;
    }
    if (!disk_->Wait(status, waiting + ", and training is waiting too")) return;
  }
}

}  // namespace craftfleet
