// LaneScheduler: grants permits, and revokes those without progress.
#include <algorithm>
#include <map>
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
  lapsed_ += permits;
  LogWarning("actor %s makes no progress: %d permits revoked, no new ones for %s", name, permits,
             absl::FormatDuration(actor->pause));
  changed_ = true;
}

void LaneScheduler::GiveToOthers(Lane* lane, Actor* actor) {
  Revoke(lane, actor);
  lane->avoided = actor;
  lane->avoided_until = clock_->Now() + options_.lease;
}

bool LaneScheduler::IsAvoided(const Lane& lane, const Actor& actor, absl::Time now) const {
  if (now >= lane.avoided_until) return false;
  const bool has_reported = lane.report.has_value() && lane.report->client == actor.worker->client.Name();
  return (lane.avoided == &actor && HasOthers(actor)) || (has_reported && HasOtherClients(actor));
}

bool LaneScheduler::IsPausing(const Actor& actor) const {
  const absl::Time now = clock_->Now();
  return (actors_.size() > 1 && now - actor.returned <= options_.patience) ||
         (now < actor.pause_end && HasOthers(actor));
}

absl::Duration LaneScheduler::Overdue() const {
  if (times_.empty()) return absl::InfiniteDuration();
  std::vector<absl::Duration> times = times_;
  const auto middle = times.begin() + times.size() / 2;
  std::nth_element(times.begin(), middle, times.end());
  return 2 * options_.patience + 4 * *middle;
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
    for (int l = 0; l < options_.lanes && room > 0 && ahead > 0; ++l) {
      Lane& lane = lanes_[l];
      if (lane.permit.has_value() || lane.record.next_fragment >= lane.last_fragment ||
          ClaimOn(lane, *actor, shares, now) != wanted) {
        continue;
      }
      SetHolder(&lane, actor);
      lane.permit = Permit{l, lane.record.next_fragment, VersionFor(lane), lane.reset_at == lane.record.next_fragment};
      lane.since = now;
      lane.pace = {0, now};
      actor->permits.insert(l);
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
  for (Lane& lane : lanes_) {
    if (static_cast<int>(actor->permits.size()) >= most) break;
    if (!lane.permit.has_value() || lane.backup != nullptr || now - lane.since <= age) continue;
    if (IsAvoided(lane, *actor, now)) continue;
    lane.backup = actor;
    lane.backup_pace = {0, now};
    actor->permits.insert(NumberOf(lane));
    granted.push_back(*lane.permit);
  }
  return granted;
}

LaneScheduler::Claim LaneScheduler::ClaimOn(const Lane& lane, const Actor& actor, const Shares& shares,
                                            absl::Time now) const {
  if (IsAvoided(lane, actor, now)) return Claim::kNone;
  if (lane.holder == &actor) return Claim::kOwn;
  const bool spare = lane.holder == nullptr || shares.IsOver(*lane.holder);
  if (spare && actor.held < shares.Of(actor)) return Claim::kSpare;
  return now - lane.since > options_.patience ? Claim::kUnclaimed : Claim::kNone;
}

int LaneScheduler::CapacityOf(const Actor& actor) {
  if (actor.worker->draining) return 0;
  return actor.pause > absl::ZeroDuration() ? std::min(actor.capacity, 1) : actor.capacity;
}

LaneScheduler::Shares LaneScheduler::FairShares() const {
  std::vector<int> capacities;
  capacities.reserve(actors_.size());
  for (const auto& [name, actor] : actors_) capacities.push_back(CapacityOf(actor));
  std::sort(capacities.begin(), capacities.end());
  Shares shares;
  int lanes = options_.lanes;
  auto actors = static_cast<int>(capacities.size());
  // If an actor can't play a full share, the others get more.
  for (const int capacity : capacities) {
    shares.all = lanes / actors;
    shares.extra = lanes % actors;
    if (capacity > shares.all) break;
    lanes -= capacity;
    --actors;
  }
  for (const auto& [name, actor] : actors_) shares.above += actor.held > shares.all ? 1 : 0;
  return shares;
}

}  // namespace craftfleet
