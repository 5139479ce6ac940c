#include "learner/scheduling/lane_scheduler.h"

#include <iterator>
#include <set>
#include <tuple>
#include <utility>

#include <absl/status/status.h>
#include <absl/strings/str_format.h>

#include "common/base/check.h"
#include "common/base/status_macros.h"

namespace craftfleet {

LaneScheduler::LaneScheduler(const Options& options, std::vector<LaneRecord> lanes, Clock* clock)
    : clock_(clock),
      table_(std::move(lanes), clock),
      assignment_(/*avoidance=*/options.lease, /*is_asynchronous=*/options.max_staleness > 0, &table_, clock),
      rollouts_({options.max_staleness, options.rollout_fragments}, &table_, clock),
      reports_(&table_, &assignment_, &rollouts_, clock) {
  CRAFTFLEET_CHECK(table_.size() == options.lanes);
  table_.counters.resets = options.resets;
}

void LaneScheduler::Remove(absl::string_view actor) {
  if (LaneActor* const found = table_.Find(actor); found != nullptr) table_.Remove(found);
}

std::vector<std::string> LaneScheduler::RemoveExpired() {
  const absl::Time now = clock_->Now();
  std::vector<std::string> expired;
  for (const auto& [name, actor] : table_.actors()) {
    if (now - actor.worker->leased_from <= actor.worker->lease) continue;
    table_.counters.lapsed += static_cast<int64_t>(actor.permits.size());
    expired.push_back(name);
  }
  for (const std::string& name : expired) Remove(name);
  return expired;
}

void LaneScheduler::NoteDrain(absl::string_view name) {
  LaneActor* const actor = table_.Find(name);
  if (actor == nullptr) return;
  table_.NoteShares();
  table_.NoteChange();
  if (!actor->worker->draining) return;
  for (const int l : std::vector<int>(actor->lanes.begin(), actor->lanes.end())) {
    LaneState& lane = table_.lanes()[l];
    if (!lane.permit.has_value()) table_.SetHolder(nullptr, &lane);
  }
}

std::vector<Permit> LaneScheduler::Renew(absl::string_view name, absl::Span<const Permit> active, int capacity) {
  LaneActor* const actor = table_.Find(name);
  table_.SetCapacity(actor, capacity);
  std::set<std::tuple<int, int64_t, int64_t>> reported;
  for (const Permit& permit : active) reported.emplace(permit.lane, permit.fragment, permit.policy_version);
  for (const int l : std::vector<int>(actor->permits.begin(), actor->permits.end())) {
    LaneState& lane = table_.lanes()[l];
    if (reported.count({l, lane.permit->fragment, lane.permit->policy_version}) > 0) continue;
    table_.Revoke(actor, &lane);
    actor->returned = clock_->Now();
    table_.NoteChange();
  }
  std::vector<Permit> lost;
  for (const Permit& permit : active) {
    const bool in_range = permit.lane >= 0 && permit.lane < table_.size();
    // The permit of a fragment that was accepted from this actor is not lost: its verdict is on the way.
    if (in_range && table_.IsAcceptedFrom(name, permit)) continue;
    const LaneState* const lane = in_range ? &table_.lanes()[permit.lane] : nullptr;
    if (lane == nullptr || !lane->IsPlayedBy(*actor) || lane->permit != permit) lost.push_back(permit);
  }
  return lost;
}

std::vector<Permit> LaneScheduler::Grant(absl::string_view actor) {
  return assignment_.Grant(rollouts_.policy_version(), rollouts_.Ahead(), table_.Find(actor));
}

absl::StatusOr<LaneScheduler::Verdict> LaneScheduler::Judge(absl::string_view actor, const Permit& fragment) const {
  CRAFTFLEET_CHECK(fragment.lane >= 0 && fragment.lane < table_.size());
  const LaneState& lane = table_.lanes()[fragment.lane];
  if (fragment.fragment < lane.record.next_fragment) return Verdict::kDuplicate;
  const LaneActor* const sender = table_.Find(actor);
  if (sender == nullptr || !lane.IsPlayedBy(*sender) || lane.permit->fragment != fragment.fragment) {
    return Verdict::kExpired;
  }
  if (fragment.policy_version == lane.permit->policy_version) return Verdict::kAccepted;
  if (rollouts_.is_asynchronous()) return Verdict::kExpired;  // of an earlier permit for this fragment
  return absl::InvalidArgumentError(absl::StrFormat("policy_version %d for fragment %d of lane %d, want %d",
                                                    fragment.policy_version, fragment.fragment, fragment.lane,
                                                    lane.permit->policy_version));
}

absl::StatusOr<LaneScheduler::Verdict> LaneScheduler::Accept(absl::string_view actor, const Permit& fragment,
                                                             const LaneSnapshot& snapshot, uint64_t digest) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const Verdict verdict, Judge(actor, fragment));
  if (verdict == Verdict::kDuplicate) table_.Compare(actor, fragment, digest);
  if (verdict != Verdict::kAccepted) return verdict;
  LaneState& lane = table_.lanes()[fragment.lane];
  LaneActor* const sender = table_.Find(actor);
  const SharedSnapshot shared(snapshot);
  assignment_.OnPlayed(sender, &lane);
  lane.report.reset();
  if (!rollouts_.Take(fragment, digest, shared, *sender)) {
    table_.NoteChange();
    return Verdict::kStale;
  }
  table_.Advance(fragment.policy_version, shared, digest, sender->worker->name, &lane);
  ++sender->fragments;
  if (lane.IsOpen()) NoteOpened(lane, *sender);
  return Verdict::kAccepted;
}

void LaneScheduler::NoteOpened(const LaneState& lane, const LaneActor& sender) {
  // Others may only take a lane from an actor that has more than its share.
  if (lane.holder == nullptr || assignment_.IsOverShare(sender)) {
    table_.NoteChange();
  } else {
    table_.NoteChange(sender.worker->name);
  }
}

}  // namespace craftfleet
