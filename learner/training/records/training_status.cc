#include "learner/training/records/training_status.h"

#include <algorithm>

#include "common/wire/status_service.h"
#include "learner/training/steps_to_train.h"

namespace craftfleet {

TrainingStatus::TrainingStatus(const v1::RunConfig& config, const TrainerCounters* counters, Clock* clock)
    : config_(config), counters_(counters), clock_(clock) {}

void TrainingStatus::OnStart(const ScoreBoard& score) {
  const MutexLock lock(&mu_);
  shown_ = ShownOf(score);
}

void TrainingStatus::OnIterationBegin() {
  const MutexLock lock(&mu_);
  iteration_begin_ = clock_->Now();
}

void TrainingStatus::OnIterationEnd(const ScoreBoard& score) {
  const MutexLock lock(&mu_);
  iteration_time_ = clock_->Now() - iteration_begin_;
  shown_ = ShownOf(score);
}

void TrainingStatus::OnUpdate(const Staleness& staleness) {
  const MutexLock lock(&mu_);
  staleness_ = staleness;
}

TrainingStatus::Shown TrainingStatus::ShownOf(const ScoreBoard& score) {
  return {score.episodes(), score.RecentReward(), score.RecentLength(), score.Score(), score.Unlocked()};
}

void TrainingStatus::Fill(const ActivityMeter& meter, absl::Duration checkpoint_age, v1::StatusReply* reply) const {
  v1::ProcessSummary* summary = reply->mutable_summary();
  wire::FillWork(meter.Total(), meter.Recent(), /*threads=*/1, summary);
  wire::FillUsage(summary);
  summary->set_lanes(config_.lanes());
  summary->set_policy_version(counters_->policy_version);
  const MutexLock lock(&mu_);
  if (iteration_time_ > absl::ZeroDuration()) {
    // If the current iteration already takes longer than the last one, the rate goes down.
    const absl::Duration time = std::max(iteration_time_, clock_->Now() - iteration_begin_);
    summary->set_steps_per_second(config_.ppo().rollout_steps() / absl::ToDoubleSeconds(time));
  }
  wire::AddMetric("iteration", static_cast<double>(counters_->iteration), reply);
  wire::AddMetric("env_steps", static_cast<double>(counters_->env_steps), reply);
  const int64_t goal =
      std::max(StepsToTrain(config_), counters_->start_steps.load());  // resumed with fewer steps than it had
  wire::AddMetric("env_steps_goal", static_cast<double>(goal), reply);
  wire::AddMetric("episodes", static_cast<double>(shown_.episodes), reply);
  wire::AddMetric("reward", shown_.reward, reply);
  wire::AddMetric("episode_length", shown_.length, reply);
  wire::AddMetric("crafter_score", shown_.score, reply);
  wire::AddMetric("achievements_unlocked", shown_.unlocked, reply);
  wire::AddMetric("staleness_min", static_cast<double>(staleness_.min), reply);
  wire::AddMetric("staleness_mean", staleness_.mean, reply);
  wire::AddMetric("staleness_max", static_cast<double>(staleness_.max), reply);
  wire::AddMetric("updates_undone", static_cast<double>(undone_.load()), reply);
  wire::AddMetric("checkpoint_age", absl::ToDoubleSeconds(checkpoint_age), reply);
}

}  // namespace craftfleet
