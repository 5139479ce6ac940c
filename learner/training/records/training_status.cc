#include "learner/training/records/training_status.h"

#include <algorithm>

#include "common/config/config.h"
#include "common/wire/status_service.h"

namespace craftfleet {

void TrainingStatus::OnStart(const RunFolder& folder) {
  const MutexLock lock(&mu_);
  Publish(folder, {});
}

void TrainingStatus::OnIterationBegin() {
  const MutexLock lock(&mu_);
  iteration_begin_ = clock_->Now();
}

void TrainingStatus::OnIterationEnd(const RunFolder& folder, const Fragment& shown, int frame_size) {
  const size_t bytes = shown.frames.size();
  const size_t frame_bytes = size_t{3} * frame_size * frame_size;
  View view;
  view.frame_size = frame_size;
  if (bytes >= frame_bytes) view.frame = shown.frames.substr(bytes - frame_bytes);
  const MutexLock lock(&mu_);
  iteration_time_ = clock_->Now() - iteration_begin_;
  const double seconds = std::max(absl::ToDoubleSeconds(iteration_time_), 1e-9);
  speed_.Add({counters_->env_steps, config_.ppo().rollout_steps() / seconds});
  Publish(folder, std::move(view));
}

void TrainingStatus::OnUpdate(const Staleness& staleness) {
  const MutexLock lock(&mu_);
  staleness_ = staleness;
}

void TrainingStatus::Publish(const RunFolder& folder, View view) {
  view.number = view_->number + 1;
  view.env_steps = counters_->env_steps;
  view.score = folder.score();
  view.curve = folder.curve().Points();
  view.speed = speed_.Points();
  view_ = std::make_shared<const View>(std::move(view));
}

std::shared_ptr<const TrainingStatus::View> TrainingStatus::view() const {
  const MutexLock lock(&mu_);
  return view_;
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
  const ScoreBoard& score = view_->score;
  wire::AddMetric("episodes", static_cast<double>(score.episodes()), reply);
  wire::AddMetric("reward", score.RecentReward(), reply);
  wire::AddMetric("episode_length", score.RecentLength(), reply);
  wire::AddMetric("crafter_score", score.Score(), reply);
  wire::AddMetric("achievements_unlocked", score.Unlocked(), reply);
  wire::AddMetric("staleness_min", static_cast<double>(staleness_.min), reply);
  wire::AddMetric("staleness_mean", staleness_.mean, reply);
  wire::AddMetric("staleness_max", static_cast<double>(staleness_.max), reply);
  wire::AddMetric("updates_undone", static_cast<double>(undone_.load()), reply);
  wire::AddMetric("checkpoint_age", absl::ToDoubleSeconds(checkpoint_age), reply);
}

}  // namespace craftfleet
