#include "learner/scheduling/evaluation_table.h"

#include <algorithm>
#include <utility>
#include <vector>

#include <absl/strings/str_format.h>
#include <absl/strings/str_join.h>

#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

bool IsSame(const Episode& a, const Episode& b) {
  return a.length == b.length && a.reward == b.reward && a.achievements == b.achievements;
}

}  // namespace

void EvaluationTable::Add(Evaluation evaluation) {
  Entry& entry = entries_.emplace_back();
  entry.evaluation = std::move(evaluation);
  for (Part& part : entry.parts) part.since = clock_->Now();
}

EvaluationTable::Player* EvaluationTable::FindPlayer(absl::string_view actor, Part* part) {
  const auto found = std::find_if(part->players.begin(), part->players.end(),
                                  [&](const Player& player) { return player.actor == actor; });
  return found == part->players.end() ? nullptr : &*found;
}

void EvaluationTable::Renew(absl::string_view actor, int64_t id, absl::Duration lease) {
  for (Entry& entry : entries_) {
    for (size_t i = 0; i < entry.parts.size(); ++i) {
      std::vector<Player>& players = entry.parts[i].players;
      Player* const player = FindPlayer(actor, &entry.parts[i]);
      if (player == nullptr) continue;
      if (TaskId(entry.evaluation, i) == id) {
        player->lease_end = clock_->Now() + lease;
      } else {
        players.erase(players.begin() + (player - players.data()));
      }
    }
  }
}

std::optional<EvaluationTable::Task> EvaluationTable::Take(absl::string_view actor, absl::Duration lease,
                                                           absl::string_view client, bool is_late) {
  const absl::Time now = clock_->Now();
  for (Entry& entry : entries_) {
    for (size_t i = 0; i < entry.parts.size(); ++i) {
      Part& part = entry.parts[i];
      if (!IsFree(part, actor, client, is_late, now)) continue;
      if (!part.players.empty()) {
        const Player& last = part.players.back();
        LogInfo("actor %s also plays evaluation task %d, which actor %s has had for %s", actor,
                TaskId(entry.evaluation, i), last.actor,
                absl::FormatDuration(absl::Trunc(now - last.since, absl::Seconds(1))));
      }
      part.since = now;
      if (Player* const player = FindPlayer(actor, &part); player != nullptr) {
        player->since = now;
        player->lease_end = now + lease;
      } else {
        part.players.push_back({std::string(actor), std::string(client), now, now + lease});
      }
      const Evaluation& evaluation = entry.evaluation;
      return Task{TaskId(evaluation, i), evaluation.first_episode + static_cast<int64_t>(i) * evaluation.episodes,
                  evaluation.episodes, /*greedy=*/i == 0};
    }
  }
  return std::nullopt;
}

bool EvaluationTable::IsFree(const Part& part, absl::string_view actor, absl::string_view client, bool is_late,
                             absl::Time now) const {
  if (!part.episodes.empty()) return false;
  const absl::Duration patience = is_late ? kPatienceWithLate : absl::ZeroDuration();
  const std::vector<Player>& players = part.players;
  const auto any = [&](const auto& is) { return std::any_of(players.begin(), players.end(), is); };
  if (!any([&](const Player& player) { return now < player.lease_end; })) {
    return now - part.since >= patience;
  }
  if (any([&](const Player& player) { return player.actor == actor; })) return false;
  const bool is_of_client = any([&](const Player& player) { return player.client == client; });
  const absl::Duration age = now - players.back().since;
  return age > overdue_.Limit() + std::max(patience, is_of_client ? kPatience : absl::ZeroDuration());
}

std::vector<std::string> EvaluationTable::BeingPlayed() const {
  std::vector<std::string> tasks;
  for (const Entry& entry : entries_) {
    for (size_t i = 0; i < entry.parts.size(); ++i) {
      const Part& part = entry.parts[i];
      if (!part.episodes.empty() || part.players.empty()) continue;
      tasks.push_back(absl::StrFormat(
          "evaluation task %d (%s)", TaskId(entry.evaluation, i),
          absl::StrJoin(part.players, ", ", [this](std::string* out, const Player& player) {
            absl::StrAppendFormat(out, "actor %s for %s", player.actor,
                                  absl::FormatDuration(absl::Trunc(clock_->Now() - player.since, absl::Seconds(1))));
          })));
    }
  }
  return tasks;
}

std::shared_ptr<const PolicyWeights> EvaluationTable::Weights(int64_t id) const {
  const size_t index = IndexOf(id);
  if (index == entries_.size() || !entries_[index].parts[id % 2].episodes.empty()) return nullptr;
  return entries_[index].evaluation.weights;
}

absl::Status EvaluationTable::Finish(absl::string_view actor, int64_t id, absl::Span<const Episode> episodes) {
  const size_t index = IndexOf(id);
  if (index == entries_.size()) return absl::OkStatus();
  const int wanted = entries_[index].evaluation.episodes;
  if (static_cast<int>(episodes.size()) != wanted) {
    return absl::InvalidArgumentError(
        absl::StrFormat("evaluation task %d: %d episodes, want %d", id, episodes.size(), wanted));
  }
  Part& part = entries_[index].parts[id % 2];
  const Player* const player = FindPlayer(actor, &part);
  if (player == nullptr) {
    return absl::FailedPreconditionError(absl::StrFormat("evaluation task %d: actor %s does not have it", id, actor));
  }
  if (!part.episodes.empty()) {
    if (std::equal(episodes.begin(), episodes.end(), part.episodes.begin(), IsSame)) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrFormat("evaluation task %d: actor %s sent another result than actor %s, which was accepted; they "
                        "should be equal: compare their programs and CPUs",
                        id, actor, part.sender));
  }
  overdue_.Add(clock_->Now() - player->since);
  part.sender = std::string(actor);
  part.episodes.assign(episodes.begin(), episodes.end());
  return absl::OkStatus();
}

bool EvaluationTable::IsPlaying(absl::string_view actor) const {
  const absl::Time now = clock_->Now();
  for (const Entry& entry : entries_) {
    for (const Part& part : entry.parts) {
      for (const Player& player : part.players) {
        if (part.episodes.empty() && player.actor == actor && now <= player.lease_end) return true;
      }
    }
  }
  return false;
}

std::optional<FinishedEvaluation> EvaluationTable::Front() const {
  if (!FrontFinished()) return std::nullopt;
  const Entry& entry = entries_.front();
  return FinishedEvaluation{entry.evaluation, entry.parts[0].episodes, entry.parts[1].episodes};
}

std::vector<Evaluation> EvaluationTable::Pending() const {
  std::vector<Evaluation> pending;
  for (const Entry& entry : entries_) pending.push_back(entry.evaluation);
  return pending;
}

size_t EvaluationTable::IndexOf(int64_t id) const {
  const auto entry = std::find_if(entries_.begin(), entries_.end(),
                                  [&](const Entry& candidate) { return candidate.evaluation.number == id / 2; });
  return static_cast<size_t>(entry - entries_.begin());
}

}  // namespace craftfleet
