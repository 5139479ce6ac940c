#include "learner/evaluation_book.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/log.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kPatience = absl::Minutes(2);
constexpr int kMaxMoves = 16;  // that lengthen it

}  // namespace

void EvaluationBook::Add(Evaluation evaluation) {
  const MutexLock lock(&mu_);
  Entry& entry = entries_.emplace_back();
  entry.evaluation = std::move(evaluation);
}

void EvaluationBook::Renew(absl::string_view actor, int64_t id) {
  const MutexLock lock(&mu_);
  for (Entry& entry : entries_) {
    for (size_t i = 0; i < entry.parts.size(); ++i) {
      Part& part = entry.parts[i];
      if (part.actor != actor) continue;
      if (TaskId(entry.evaluation, i) == id) {
        part.last_word = clock_->Now();
      } else {
        part.actor.clear();
      }
    }
  }
}

std::optional<EvaluationBook::Task> EvaluationBook::Take(absl::string_view actor) {
  const MutexLock lock(&mu_);
  const absl::Time now = clock_->Now();
  for (Entry& entry : entries_) {
    for (size_t i = 0; i < entry.parts.size(); ++i) {
      Part& part = entry.parts[i];
      if (!IsFree(part, actor, now)) continue;
      if (!part.actor.empty() && now - part.last_word < lease_) {
        ++part.moves;
        LogWarning("actor %s has had evaluation task %d for %s: actor %s plays it too", part.actor,
                   TaskId(entry.evaluation, i), absl::FormatDuration(absl::Trunc(now - part.begun, absl::Seconds(1))),
                   actor);
      }
      part.actor = std::string(actor);
      part.last_word = now;
      part.begun = now;
      const Evaluation& evaluation = entry.evaluation;
      return Task{TaskId(evaluation, i), evaluation.first_episode + static_cast<int64_t>(i) * evaluation.episodes,
                  evaluation.episodes, /*greedy=*/i == 0};
    }
  }
  return std::nullopt;
}

bool EvaluationBook::IsFree(const Part& part, absl::string_view actor, absl::Time now) const {
  if (!part.episodes.empty()) return false;
  if (part.actor.empty() || now - part.last_word >= lease_) return true;
  const absl::Duration patience = std::max(kPatience, 4 * longest_) * (int64_t{1} << std::min(part.moves, kMaxMoves));
  return part.actor != actor && now - part.begun > patience;
}

std::shared_ptr<const std::string> EvaluationBook::Weights(int64_t id) const {
  const MutexLock lock(&mu_);
  const size_t index = IndexOf(id);
  if (index == entries_.size() || !entries_[index].parts[id % 2].episodes.empty()) return nullptr;
  return entries_[index].evaluation.weights;
}

absl::Status EvaluationBook::Finish(int64_t id, absl::Span<const Episode> episodes) {
  const MutexLock lock(&mu_);
  const size_t index = IndexOf(id);
  if (index == entries_.size()) return absl::OkStatus();
  const int wanted = entries_[index].evaluation.episodes;
  if (static_cast<int>(episodes.size()) != wanted) {
    return absl::InvalidArgumentError(
        absl::StrFormat("evaluation task %d: %d episodes, want %d", id, episodes.size(), wanted));
  }
  Part& part = entries_[index].parts[id % 2];
  if (!part.episodes.empty()) return absl::OkStatus();
  if (!part.actor.empty()) longest_ = std::max(longest_, clock_->Now() - part.begun);
  part.actor.clear();
  part.episodes.assign(episodes.begin(), episodes.end());
  changed_.NotifyAll();
  return absl::OkStatus();
}

bool EvaluationBook::IsPlaying(absl::string_view actor) const {
  const MutexLock lock(&mu_);
  for (const Entry& entry : entries_) {
    for (const Part& part : entry.parts) {
      if (part.actor == actor && clock_->Now() - part.last_word <= lease_) return true;
    }
  }
  return false;
}

std::optional<FinishedEvaluation> EvaluationBook::Front(absl::Duration timeout) {
  const MutexLock lock(&mu_);
  changed_.WaitFor(&mu_, timeout, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return FrontFinished(); });
  if (!FrontFinished()) return std::nullopt;
  const Entry& entry = entries_.front();
  return FinishedEvaluation{entry.evaluation, entry.parts[0].episodes, entry.parts[1].episodes};
}

void EvaluationBook::Pop() {
  const MutexLock lock(&mu_);
  entries_.pop_front();
}

std::vector<Evaluation> EvaluationBook::Pending() const {
  const MutexLock lock(&mu_);
  std::vector<Evaluation> pending;
  for (const Entry& entry : entries_) pending.push_back(entry.evaluation);
  return pending;
}

size_t EvaluationBook::pending() const {
  const MutexLock lock(&mu_);
  return entries_.size();
}

size_t EvaluationBook::IndexOf(int64_t id) const {
  const auto entry = std::find_if(entries_.begin(), entries_.end(),
                                  [&](const Entry& candidate) { return candidate.evaluation.number == id / 2; });
  return static_cast<size_t>(entry - entries_.begin());
}

}  // namespace craftfleet
