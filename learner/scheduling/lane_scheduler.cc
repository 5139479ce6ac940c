#include "learner/scheduling/lane_scheduler.h"

#include <algorithm>
#include <iterator>
#include <set>
#include <tuple>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/check.h"
#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/telemetry/log.h"

namespace craftfleet {

namespace {

constexpr int kMaxUnanswered = 3;

}  // namespace

LaneScheduler::LaneScheduler(const Options& options, std::vector<LaneRecord> lanes, Clock* clock)
    : options_(options),
      clock_(clock),
      resets_(options.resets),
      overdue_(options.overdue, options.overdue_at_first),
      drops_(clock) {
  CRAFTFLEET_CHECK(static_cast<int>(lanes.size()) == options.lanes);
  for (LaneRecord& record : lanes) {
    Lane& lane = lanes_.emplace_back();
    lane.start = record;
    lane.record = std::move(record);
    lane.since = clock_->Now();
  }
}

void LaneScheduler::Add(const Worker* worker) {
  Actor& actor = actors_[worker->name];
  if (actor.number == 0) actor.number = ++last_actor_;
  actor.worker = worker;
  actor.capacity = options_.lanes;  // until it reports its own
  shares_.reset();
  NoteLease(*worker);
}

void LaneScheduler::NoteLease(const Worker& worker) {
  next_expiry_ = std::min(next_expiry_, worker.leased_from + worker.lease);
}

void LaneScheduler::Remove(absl::string_view actor) {
  if (const auto entry = actors_.find(actor); entry != actors_.end()) Remove(entry);
}

std::vector<std::string> LaneScheduler::RemoveExpired() {
  const absl::Time now = clock_->Now();
  std::vector<std::string> expired;
  if (now <= next_expiry_) return expired;
  next_expiry_ = absl::InfiniteFuture();
  for (auto actor = actors_.begin(); actor != actors_.end();) {
    const auto next = std::next(actor);
    if (now - actor->second.worker->leased_from > actor->second.worker->lease) {
      lapsed_ += static_cast<int64_t>(actor->second.permits.size());
      expired.push_back(actor->first);
      Remove(actor);
    } else {
      NoteLease(*actor->second.worker);
    }
    actor = next;
  }
  return expired;
}

void LaneScheduler::Remove(ActorMap::iterator actor) {
  for (const int l : std::vector<int>(actor->second.permits.begin(), actor->second.permits.end())) {
    Revoke(&lanes_[l], &actor->second);
  }
  for (const int l : std::vector<int>(actor->second.lanes.begin(), actor->second.lanes.end())) {
    SetHolder(&lanes_[l], nullptr);
  }
  shares_.reset();
  actors_.erase(actor);
  change_.all = true;
}

absl::StatusOr<LaneScheduler::Verdict> LaneScheduler::Accept(absl::string_view actor, const Permit& fragment,
                                                             const LaneSnapshot& snapshot, uint64_t digest) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const Verdict verdict, Judge(actor, fragment));
  if (verdict == Verdict::kDuplicate) Compare(actor, fragment, digest);
  if (verdict != Verdict::kAccepted) return verdict;
  Lane& lane = lanes_[fragment.lane];
  const auto sender = actors_.find(actor);
  const SharedSnapshot shared(snapshot);
  EndPlayed(&lane, &sender->second);
  if (options_.max_staleness > 0) {
    if (StalenessOf(fragment.policy_version) > options_.max_staleness) {
      Drop(fragment, sender->first);
      change_.all = true;
      return Verdict::kStale;
    }
    waiting_.push_back({{fragment, digest}, shared, sender->first});
  }
  lane.record = {fragment.fragment + 1, shared, std::move(lane.record.snapshot), sender->first};
  lane.accepted.push_back({fragment.fragment, digest, sender->first});
  ++sender->second.fragments;
  if (lane.IsOpen()) NoteOpened(lane, sender->second);
  return Verdict::kAccepted;
}

absl::StatusOr<LaneScheduler::Verdict> LaneScheduler::Judge(absl::string_view actor, const Permit& fragment) const {
  CRAFTFLEET_CHECK(fragment.lane >= 0 && fragment.lane < options_.lanes);
  const Lane& lane = lanes_[fragment.lane];
  if (fragment.fragment < lane.record.next_fragment) return Verdict::kDuplicate;
  const auto sender = actors_.find(actor);
  if (sender == actors_.end() || !IsPlayer(lane, &sender->second) || !lane.permit.has_value() ||
      lane.permit->fragment != fragment.fragment) {
    return Verdict::kExpired;
  }
  if (fragment.policy_version == lane.permit->policy_version) return Verdict::kAccepted;
  if (options_.max_staleness > 0) return Verdict::kExpired;  // of an earlier permit for this fragment
  return absl::InvalidArgumentError(absl::StrFormat("policy_version %d for fragment %d of lane %d, want %d",
                                                    fragment.policy_version, fragment.fragment, fragment.lane,
                                                    lane.permit->policy_version));
}

void LaneScheduler::NoteOpened(const Lane& lane, const Actor& sender) {
  // Others may only take a lane from an actor that has more than its share.
  if (lane.holder == nullptr || FairShares().IsOver(sender)) {
    change_.all = true;
  } else {
    change_.actors.push_back(sender.worker->name);
  }
}

void LaneScheduler::Drop(const Permit& fragment, const std::string& actor) {
  ++dropped_;
  drops_.Warn(actors_.at(actor).worker->client.Name(),
              absl::StrFormat("fragment %d of lane %d from actor %s is dropped and played again: its weights are %d "
                              "updates old, max_staleness is %d (dropped so far, of all actors: %d)",
                              fragment.fragment, fragment.lane, actor, StalenessOf(fragment.policy_version),
                              options_.max_staleness, dropped_));
}

void LaneScheduler::EndPlayed(Lane* lane, Actor* sender) {
  PauseLate(*lane, *sender);
  for (const Player& player : lane->players) {
    if (player.actor == sender) overdue_.Add(clock_->Now() - player.since);
  }
  EndPermit(lane);
  SetHolder(lane, sender->worker->draining ? nullptr : sender);
  lane->avoided = 0;
  lane->report.reset();
  EndPause(sender);
}

void LaneScheduler::Compare(absl::string_view actor, const Permit& fragment, uint64_t digest) {
  if (!IsKnown(actor)) return;
  for (AcceptedFragment& accepted : lanes_[fragment.lane].accepted) {
    if (accepted.fragment != fragment.fragment || accepted.digest == digest) continue;
    ++differing_;
    if (accepted.differs) continue;
    accepted.differs = true;
    LogError(
        "fragment %d of lane %d: actor %s sent %016x, which was accepted, and actor %s sent %016x; they should be "
        "equal: "
        "compare their programs and CPUs",
        fragment.fragment, fragment.lane, accepted.sender, accepted.digest, actor, digest);
  }
}

bool LaneScheduler::Restore(const Permit& fragment, const LaneSnapshot& snapshot, uint64_t digest) {
  CRAFTFLEET_CHECK(fragment.lane >= 0 && fragment.lane < options_.lanes);
  Lane& lane = lanes_[fragment.lane];
  if (lane.record.next_fragment != fragment.fragment || lane.permit.has_value()) return false;
  lane.record = {fragment.fragment + 1, snapshot, std::move(lane.record.snapshot), ""};
  lane.accepted.push_back({fragment.fragment, digest, "an earlier start"});
  lane.restored = true;
  return true;
}

bool LaneScheduler::Counts(int lane, int64_t fragment, uint64_t digest) const {
  const std::deque<AcceptedFragment>& accepted = lanes_[lane].accepted;
  return std::any_of(accepted.begin(), accepted.end(),
                     [&](const AcceptedFragment& t) { return t.fragment == fragment && t.digest == digest; });
}

void LaneScheduler::Refuse(absl::string_view actor_name, int l, int64_t fragment, absl::string_view reason) {
  const auto actor = actors_.find(actor_name);
  if (actor == actors_.end() || l < 0 || l >= options_.lanes) return;
  Lane& lane = lanes_[l];
  if (!IsPlayer(lane, &actor->second) || !lane.permit.has_value() || lane.permit->fragment != fragment) return;
  GiveToOthers(&lane, &actor->second);
  change_.all = true;
  if (lane.record.snapshot->game.empty()) return;  // a new game cannot be reset
  const bool is_first = !lane.report.has_value();
  const bool is_confirmed = !is_first && (IsIndependent(*lane.report, actor->second) || !HasOthers(actor->second) ||
                                          lane.report->unanswered >= kMaxUnanswered);
  if (is_first) lane.report = Report{actor->second.worker->client.Name(), actor->first};
  // Others are not logged: a lying actor may repeat its report for ever.
  if (is_first || is_confirmed) LogWarning("actor %s can't restore lane %d: %s", actor->first, l, Printable(reason));
  if (is_confirmed && !lane.permit.has_value()) Reset(&lane, reason);
}

bool LaneScheduler::IsIndependent(const Report& report, const Actor& actor) const {
  const Worker& worker = *actor.worker;
  return worker.client.Name() != report.client || (worker.name != report.actor && !HasOtherClients(actor));
}

void LaneScheduler::Reset(Lane* lane, absl::string_view reason) {
  LaneRecord& record = lane->record;
  const std::string sender = record.sender.empty() ? "an earlier start" : absl::StrCat("actor ", record.sender);
  const std::string error = absl::StrFormat("lane %d: the snapshot after its fragment %d, from %s, is not a game (%s)",
                                            NumberOf(*lane), record.next_fragment - 1, sender, Printable(reason));
  if (record.next_fragment > lane->start.next_fragment) {
    LogError("%s; it is played again from fragment %d on", error, lane->start.next_fragment);
    Rewind(lane);
  } else {
    LogError("%s; it resumes %s", error,
             record.previous->game.empty() ? "with a new game" : "from the snapshot before that fragment");
    LaneSnapshot previous = *record.previous;
    previous.state.resize(record.snapshot->state.size());
    record.snapshot = std::move(previous);
    record.previous = {};
    record.sender.clear();
    lane->start = record;
    lane->reset_at = record.next_fragment;  // its number does not change
  }
  ++resets_;
  lane->report.reset();
  lane->avoided = 0;
}

absl::StatusOr<LaneSnapshot> LaneScheduler::Snapshot(int lane, int64_t fragment) const {
  if (lane < 0 || lane >= options_.lanes) {
    return absl::InvalidArgumentError(absl::StrFormat("lane %d, want 0..%d", lane, options_.lanes - 1));
  }
  const LaneRecord& record = lanes_[lane].record;
  if (record.next_fragment != fragment) {
    return absl::AbortedError(absl::StrFormat("lane %d is at fragment %d, not %d: request permits again", lane,
                                              record.next_fragment, fragment));
  }
  return *record.snapshot;
}

bool LaneScheduler::SetPaused(bool paused) {
  const bool before = paused_;
  paused_ = paused;
  // Time in the pause must not count as time unclaimed.
  for (Lane& lane : lanes_) lane.since = clock_->Now();
  change_.all = true;
  return before;
}

void LaneScheduler::NoteDrain(absl::string_view actor_name) {
  const auto entry = actors_.find(actor_name);
  if (entry == actors_.end()) return;
  Actor* const actor = &entry->second;
  shares_.reset();
  change_.all = true;
  if (!actor->worker->draining) return;
  for (const int l : std::vector<int>(actor->lanes.begin(), actor->lanes.end())) {
    if (lanes_[l].permit.has_value()) continue;
    SetHolder(&lanes_[l], nullptr);
  }
}

bool LaneScheduler::IsPlayer(const Lane& lane, const Actor* actor) {
  return std::any_of(lane.players.begin(), lane.players.end(),
                     [actor](const Player& player) { return player.actor == actor; });
}

std::vector<LaneScheduler::Playing> LaneScheduler::BeingPlayed() const {
  std::vector<Playing> playing;
  for (const Lane& lane : lanes_) {
    if (!lane.permit.has_value()) continue;
    Playing& one = playing.emplace_back(Playing{*lane.permit, {}});
    for (const Player& player : lane.players) {
      one.actors.emplace_back(player.actor->worker->name, clock_->Now() - player.since);
    }
  }
  std::stable_sort(playing.begin(), playing.end(), [](const Playing& a, const Playing& b) {
    return a.actors.front().second > b.actors.front().second;
  });
  return playing;
}

int LaneScheduler::permits() const {
  size_t permits = 0;
  for (const auto& [name, actor] : actors_) permits += actor.permits.size();
  return static_cast<int>(permits);
}

int LaneScheduler::PermitsOf(absl::string_view actor) const {
  const auto entry = Find(actor);
  return entry == actors_.end() ? 0 : static_cast<int>(entry->second.permits.size());
}

std::vector<LaneRecord> LaneScheduler::Records() const {
  std::vector<LaneRecord> records;
  for (const Lane& lane : lanes_) records.push_back(lane.record);
  return records;
}

std::vector<LaneRecord> LaneScheduler::StartRecords() const {
  std::vector<LaneRecord> records;
  for (const Lane& lane : lanes_) records.push_back(lane.start);
  return records;
}

std::vector<LaneScheduler::ActorInfo> LaneScheduler::Actors() const {
  std::vector<ActorInfo> infos;
  for (const auto& actor : actors_) infos.push_back(InfoOf(actor));
  return infos;
}

LaneScheduler::ActorInfo LaneScheduler::InfoOf(const ActorMap::value_type& entry) const {
  const Actor& actor = entry.second;
  return {entry.first,
          actor.worker->address,
          static_cast<int>(actor.permits.size()),
          actor.fragments,
          clock_->Now() - actor.worker->leased_from,
          actor.worker->draining,
          actor.pause > absl::ZeroDuration()};
}

bool LaneScheduler::IsAcceptedFrom(absl::string_view actor, const Permit& fragment) const {
  const std::deque<AcceptedFragment>& accepted = lanes_[fragment.lane].accepted;
  return std::any_of(accepted.begin(), accepted.end(),
                     [&](const AcceptedFragment& t) { return t.fragment == fragment.fragment && t.sender == actor; });
}

std::vector<Permit> LaneScheduler::Renew(absl::string_view actor_name, absl::Span<const Permit> active, int capacity) {
  Actor* const actor = &actors_.find(actor_name)->second;
  capacity = std::clamp(capacity, 0, options_.lanes);
  if (std::exchange(actor->capacity, capacity) != capacity) shares_.reset();
  std::set<std::tuple<int, int64_t, int64_t>> reported;
  for (const Permit& permit : active) reported.emplace(permit.lane, permit.fragment, permit.policy_version);
  for (const int l : std::vector<int>(actor->permits.begin(), actor->permits.end())) {
    Lane& lane = lanes_[l];
    if (reported.count({l, lane.permit->fragment, lane.permit->policy_version}) > 0) continue;
    Revoke(&lane, actor);
    actor->returned = clock_->Now();
    change_.all = true;
  }
  std::vector<Permit> lost;
  for (const Permit& permit : active) {
    const bool in_range = permit.lane >= 0 && permit.lane < options_.lanes;
    // The permit of a fragment that was accepted from this actor is not lost: its verdict is on the way.
    if (in_range && IsAcceptedFrom(actor_name, permit)) continue;
    if (!in_range || !IsPlayer(lanes_[permit.lane], actor) || lanes_[permit.lane].permit != permit) {
      lost.push_back(permit);
    }
  }
  return lost;
}

void LaneScheduler::SetHolder(Lane* lane, Actor* actor) {
  if (lane->holder == actor) return;
  if (lane->holder != nullptr) lane->holder->lanes.erase(NumberOf(*lane));
  if (actor != nullptr) actor->lanes.insert(NumberOf(*lane));
  lane->holder = actor;
  shares_.reset();
}

void LaneScheduler::EndPermit(Lane* lane) {
  const int l = NumberOf(*lane);
  for (const Player& player : lane->players) player.actor->permits.erase(l);
  lane->players.clear();
  lane->permit.reset();
  lane->since = clock_->Now();
  --playing_;
}

void LaneScheduler::Revoke(Lane* lane, Actor* actor) {
  if (!IsPlayer(*lane, actor)) return;
  if (lane->report.has_value() && IsIndependent(*lane->report, *actor)) ++lane->report->unanswered;
  if (lane->players.size() == 1) {
    EndPermit(lane);
    SetHolder(lane, nullptr);
    lane->since = absl::InfinitePast();  // free for any actor at once
  } else {
    actor->permits.erase(NumberOf(*lane));
    std::vector<Player>& players = lane->players;
    players.erase(std::find_if(players.begin(), players.end(), [&](const Player& p) { return p.actor == actor; }));
    SetHolder(lane, players.front().actor);
    lane->since = players.back().since;
  }
}

}  // namespace craftfleet
