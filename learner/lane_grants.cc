// LaneScheduler: grants permits, and revokes those without progress.
#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "common/telemetry/log.h"
#include "learner/lane_scheduler.h"

namespace craftfleet {
namespace {

constexpr int kMaxDoublings = 16;  // of the time after which a lane without progress is revoked
constexpr absl::Duration kFirstPause = absl::Seconds(1);
constexpr absl::Duration kLongestPause = absl::Minutes(5);

}  // namespace

void LaneScheduler::NoteProgress(absl::string_view actor_name, absl::Span<const Permit> active,
                                 absl::Span<const int64_t> steps) {
  const auto entry = actors_.find(actor_name);
  if (entry == actors_.end()) return;
  Actor* const actor = &entry->second;
  for (size_t i = 0; i < std::min(active.size(), steps.size()); ++i) {
    if (active[i].lane < 0 || active[i].lane >= options_.lanes) continue;
    Lane& lane = lanes_[active[i].lane];
    if (!IsPlayer(lane, actor) || lane.permit != active[i]) continue;
    Pace& pace = lane.holder == actor ? lane.pace : lane.backup_pace;
    if (steps[i] > pace.steps) {
      pace.grew = clock_->Now();
      EndPause(actor);
    }
    pace.steps = steps[i];
  }
}

void LaneScheduler::EndPause(Actor* actor) {
  actor->pause = absl::ZeroDuration();
  actor->pause_end = absl::InfinitePast();
  CountCapacity(actor);
}

bool LaneScheduler::HasOthers(const Actor& actor) const {
  return std::any_of(actors_.begin(), actors_.end(), [&](const auto& entry) {
    return &entry.second != &actor && !entry.second.worker->draining && entry.second.capacity > 0;
  });
}

bool LaneScheduler::HasOtherClients(const Actor& actor) const {
  return std::any_of(actors_.begin(), actors_.end(), [&](const auto& entry) {
    const Worker& other = *entry.second.worker;
    return other.client.Name() != actor.worker->client.Name() && !other.draining && entry.second.capacity > 0;
  });
}

absl::Time LaneScheduler::StallsAt(const Lane& lane, const Pace& pace) const {
  return pace.grew + options_.progress * (int64_t{1} << std::min(lane.stalls, kMaxDoublings));
}

bool LaneScheduler::IsStalled(const Lane& lane, const Actor* player, const Pace& pace) const {
  if (player == nullptr || !lane.permit.has_value()) return false;
  return clock_->Now() > StallsAt(lane, pace) && HasOthers(*player);
}

void LaneScheduler::EndStalls() {
  const absl::Time now = clock_->Now();
  if (now <= next_stall_) return;
  next_stall_ = now + options_.progress;  // of permits granted from now on
  std::map<Actor*, int> stalled;          // number of revoked permits
  for (Lane& lane : lanes_) {
    if (!lane.permit.has_value()) continue;
    bool stalls = false;
    // Check the holder twice: if it is revoked, the backup becomes the holder.
    for (int i = 0; i < 2 && IsStalled(lane, lane.holder, lane.pace); ++i) {
      ++stalled[lane.holder];
      GiveToOthers(&lane, lane.holder);
      stalls = true;
    }
    if (IsStalled(lane, lane.backup, lane.backup_pace)) {
      ++stalled[lane.backup];
      GiveToOthers(&lane, lane.backup);
      stalls = true;
    }
    if (stalls) ++lane.stalls;
    if (!lane.permit.has_value()) continue;
    next_stall_ = std::min(next_stall_, StallsAt(lane, lane.pace));
    if (lane.backup != nullptr) next_stall_ = std::min(next_stall_, StallsAt(lane, lane.backup_pace));
  }
  for (auto& [name, actor] : actors_) {
    if (const auto entry = stalled.find(&actor); entry != stalled.end()) PauseStalled(name, &actor, entry->second);
  }
}

void LaneScheduler::PauseStalled(absl::string_view name, Actor* actor, int permits) {
  actor->pause = std::clamp(2 * actor->pause, kFirstPause, kLongestPause);
  actor->pause_end = clock_->Now() + actor->pause;
  CountCapacity(actor);
  lapsed_ += permits;
  LogWarning("actor %s makes no progress: %d permits revoked, no new ones for %s", name, permits,
             absl::FormatDuration(actor->pause));
  change_.all = true;
}

void LaneScheduler::GiveToOthers(Lane* lane, Actor* actor) {
  Revoke(lane, actor);
  lane->avoided = actor->number;
  lane->avoided_until = clock_->Now() + options_.lease;
}

bool LaneScheduler::IsAvoided(const Lane& lane, const Actor& actor, absl::Time now) const {
  if (now >= lane.avoided_until) return false;
  const bool has_reported = lane.report.has_value() && lane.report->client == actor.worker->client.Name();
  return (lane.avoided == actor.number && HasOthers(actor)) || (has_reported && HasOtherClients(actor));
}

bool LaneScheduler::IsPausing(const Actor& actor) const {
  const absl::Time now = clock_->Now();
  return (actors_.size() > 1 && now - actor.returned <= options_.patience) ||
         (now < actor.pause_end && HasOthers(actor));
}

absl::Duration LaneScheduler::Overdue() const {
  const std::optional<absl::Duration> median = times_.Get();
  return median.has_value() ? 2 * options_.patience + 4 * *median : absl::InfiniteDuration();
}

std::vector<Permit> LaneScheduler::Grant(absl::string_view actor_name) {
  Actor* const actor = &actors_.find(actor_name)->second;
  if (paused_ || actor->worker->draining || IsPausing(*actor)) return {};
  const absl::Time now = clock_->Now();
  const Shares shares = FairShares();
  int64_t ahead = Ahead();
  std::vector<Permit> granted;
  for (const Claim wanted : {Claim::kOwn, Claim::kSpare, Claim::kUnclaimed}) {
    const int share = wanted == Claim::kUnclaimed ? shares.Most() : shares.Of(*actor);
    int room = std::min(CapacityOf(*actor), share) - static_cast<int>(actor->permits.size());
    if (room <= 0 || ahead <= 0) continue;
    const Candidates candidates = CandidatesFor(wanted, *actor, shares, now);
    for (int l = candidates.Next(-1); l >= 0 && room > 0 && ahead > 0; l = candidates.Next(l)) {
      Lane& lane = lanes_[l];
      if (!lane.IsOpen() || ClaimOn(lane, *actor, shares, now) != wanted) continue;
      SetHolder(&lane, actor);
      lane.permit = Permit{l, lane.record.next_fragment, policy_version_, lane.reset_at == lane.record.next_fragment};
      lane.since = now;
      lane.pace = {0, now};
      actor->permits.insert(l);
      ++playing_;
      List(&lane);
      granted.push_back(*lane.permit);
      --room;
      --ahead;
    }
  }
  return granted.empty() && actor->permits.empty() ? GrantBackup(actor, shares) : granted;
}

std::vector<Permit> LaneScheduler::GrantBackup(Actor* actor, const Shares& shares) {
  const absl::Time now = clock_->Now();
  const int most = std::min(CapacityOf(*actor), shares.Most());
  const absl::Duration age = lapsed_ > lapsed_before_ ? std::min(options_.patience, Overdue()) : Overdue();
  std::vector<Permit> granted;
  if (most <= 0) return granted;
  for (const int l : OlderThan(without_backup_, age, now)) {
    if (static_cast<int>(actor->permits.size()) >= most) break;
    Lane& lane = lanes_[l];
    if (IsAvoided(lane, *actor, now)) continue;
    lane.backup = actor;
    lane.backup_pace = {0, now};
    List(&lane);
    actor->permits.insert(l);
    granted.push_back(*lane.permit);
  }
  return granted;
}

LaneScheduler::Candidates LaneScheduler::CandidatesFor(Claim claim, const Actor& actor, const Shares& shares,
                                                       absl::Time now) const {
  static const std::set<int> none;
  if (claim == Claim::kOwn) return {&actor.open, {}};
  if (claim == Claim::kUnclaimed) return {&none, OlderThan(open_, options_.patience, now)};
  if (actor.held() >= shares.Of(actor)) return {&none, {}};
  Candidates spare = {&open_and_free_, {}};
  // Of holders above their share alone: every one looked at has a lane to give.
  const int least = shares.above > shares.extra ? shares.all : shares.all + 1;
  for (auto held = open_by_held_.upper_bound(least); held != open_by_held_.end(); ++held) {
    for (const Actor* const other : held->second) {
      spare.more.insert(spare.more.end(), other->open.begin(), other->open.end());
    }
  }
  std::sort(spare.more.begin(), spare.more.end());
  return spare;
}

int LaneScheduler::Candidates::Next(int after) const {
  const auto listed = list->upper_bound(after);
  const auto other = std::upper_bound(more.begin(), more.end(), after);
  if (listed == list->end()) return other == more.end() ? -1 : *other;
  return other == more.end() ? *listed : std::min(*listed, *other);
}

LaneScheduler::Claim LaneScheduler::ClaimOn(const Lane& lane, const Actor& actor, const Shares& shares,
                                            absl::Time now) const {
  if (IsAvoided(lane, actor, now)) return Claim::kNone;
  if (lane.holder == &actor) return Claim::kOwn;
  const bool spare = lane.holder == nullptr || shares.IsOver(*lane.holder);
  if (spare && actor.held() < shares.Of(actor)) return Claim::kSpare;
  return now - lane.since > options_.patience ? Claim::kUnclaimed : Claim::kNone;
}

int LaneScheduler::CapacityOf(const Actor& actor) {
  if (actor.worker->draining) return 0;
  return actor.pause > absl::ZeroDuration() ? std::min(actor.capacity, 1) : actor.capacity;
}

void LaneScheduler::CountCapacity(Actor* actor) {
  UncountCapacity(actor);
  actor->counted_capacity = CapacityOf(*actor);
  ++capacities_[actor->counted_capacity];
}

void LaneScheduler::UncountCapacity(Actor* actor) {
  const auto counted = capacities_.find(std::exchange(actor->counted_capacity, -1));
  if (counted != capacities_.end() && --counted->second == 0) capacities_.erase(counted);
}

LaneScheduler::Shares LaneScheduler::FairShares() const {
  Shares shares;
  int lanes = options_.lanes;
  auto actors = static_cast<int>(actors_.size());
  // If an actor can't play a full share, the others get more.
  for (const auto& [capacity, count] : capacities_) {
    shares.all = lanes / actors;
    shares.extra = lanes % actors;
    if (capacity > shares.all) break;
    lanes -= (count - 1) * capacity;
    actors -= count - 1;
    shares.all = lanes / actors;  // what the last one of these leaves
    shares.extra = lanes % actors;
    lanes -= capacity;
    --actors;
  }
  for (auto held = by_held_.upper_bound(shares.all); held != by_held_.end(); ++held) shares.above += held->second;
  return shares;
}

}  // namespace craftfleet
