#include "learner/evaluation_scheduler.h"

#include <algorithm>
#include <utility>
#include <vector>

#include <absl/strings/str_format.h>

#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kPatience = absl::Minutes(2);
constexpr int kMaxMoves = 16;     // each doubles the patience
constexpr size_t kMaxTimes = 16;  // of tasks, which get longer as training goes on

}  // namespace

void EvaluationScheduler::Add(Evaluation evaluation) {
  Entry& entry = entries_.emplace_back();
  entry.evaluation = std::move(evaluation);
}

void EvaluationScheduler::Renew(absl::string_view actor, int64_t id, absl::Duration lease) {
  for (Entry& entry : entries_) {
    for (size_t i = 0; i < entry.parts.size(); ++i) {
      Part& part = entry.parts[i];
      if (part.actor != actor) continue;
      if (TaskId(entry.evaluation, i) == id) {
        part.lease_end = clock_->Now() + lease;
      } else {
        part.actor.clear();
      }
    }
  }
}

std::optional<EvaluationScheduler::Task> EvaluationScheduler::Take(absl::string_view actor, absl::Duration lease) {
  const absl::Time now = clock_->Now();
  for (Entry& entry : entries_) {
    for (size_t i = 0; i < entry.parts.size(); ++i) {
      Part& part = entry.parts[i];
      if (!IsFree(part, actor, now)) continue;
      if (!part.actor.empty() && now < part.lease_end) {
        ++part.moves;
        LogWarning("actor %s has had evaluation task %d for %s: actor %s plays it too", part.actor,
                   TaskId(entry.evaluation, i), absl::FormatDuration(absl::Trunc(now - part.begun, absl::Seconds(1))),
                   actor);
      }
      part.actor = std::string(actor);
      part.lease_end = now + lease;
      part.begun = now;
      const Evaluation& evaluation = entry.evaluation;
      return Task{TaskId(evaluation, i), evaluation.first_episode + static_cast<int64_t>(i) * evaluation.episodes,
                  evaluation.episodes, /*greedy=*/i == 0};
    }
  }
  return std::nullopt;
}

absl::Duration EvaluationScheduler::Patience() const {
  if (times_.empty()) return kPatience;
  std::vector<absl::Duration> times(times_.begin(), times_.end());
  const auto middle = times.begin() + (times.size() - 1) / 2;
  std::nth_element(times.begin(), middle, times.end());
  return std::max(kPatience, 4 * *middle);
}

bool EvaluationScheduler::IsFree(const Part& part, absl::string_view actor, absl::Time now) const {
  if (!part.episodes.empty()) return false;
  if (part.actor.empty() || now >= part.lease_end) return true;
  return part.actor != actor && now - part.begun > Patience() * (int64_t{1} << std::min(part.moves, kMaxMoves));
}

std::shared_ptr<const std::string> EvaluationScheduler::Weights(int64_t id) const {
  const size_t index = IndexOf(id);
  if (index == entries_.size() || !entries_[index].parts[id % 2].episodes.empty()) return nullptr;
  return entries_[index].evaluation.weights;
}

absl::Status EvaluationScheduler::Finish(int64_t id, absl::Span<const Episode> episodes) {
  const size_t index = IndexOf(id);
  if (index == entries_.size()) return absl::OkStatus();
  const int wanted = entries_[index].evaluation.episodes;
  if (static_cast<int>(episodes.size()) != wanted) {
    return absl::InvalidArgumentError(
        absl::StrFormat("evaluation task %d: %d episodes, want %d", id, episodes.size(), wanted));
  }
  Part& part = entries_[index].parts[id % 2];
  if (!part.episodes.empty()) return absl::OkStatus();
  if (!part.actor.empty()) times_.push_back(clock_->Now() - part.begun);
  if (times_.size() > kMaxTimes) times_.pop_front();
  part.actor.clear();
  part.episodes.assign(episodes.begin(), episodes.end());
  return absl::OkStatus();
}

bool EvaluationScheduler::IsPlaying(absl::string_view actor) const {
  for (const Entry& entry : entries_) {
    for (const Part& part : entry.parts) {
      if (part.actor == actor && clock_->Now() <= part.lease_end) return true;
    }
  }
  return false;
}

std::optional<FinishedEvaluation> EvaluationScheduler::Front() const {
  if (!FrontFinished()) return std::nullopt;
  const Entry& entry = entries_.front();
  return FinishedEvaluation{entry.evaluation, entry.parts[0].episodes, entry.parts[1].episodes};
}

std::vector<Evaluation> EvaluationScheduler::Pending() const {
  std::vector<Evaluation> pending;
  for (const Entry& entry : entries_) pending.push_back(entry.evaluation);
  return pending;
}

size_t EvaluationScheduler::IndexOf(int64_t id) const {
  const auto entry = std::find_if(entries_.begin(), entries_.end(),
                                  [&](const Entry& candidate) { return candidate.evaluation.number == id / 2; });
  return static_cast<size_t>(entry - entries_.begin());
}

}  // namespace craftfleet
