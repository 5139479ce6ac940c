// Who gets which lane, and who loses one for lack of progress.
#include <algorithm>
#include <map>
#include <vector>

#include "common/log.h"
#include "learner/lane_ledger.h"

namespace craftfleet {
namespace {

constexpr int kMaxDoublings = 16;  // of the time that a lane may take without progress
constexpr absl::Duration kFirstPause = absl::Seconds(1);
constexpr absl::Duration kLongestPause = absl::Minutes(5);

}  // namespace

void LaneLedger::NoteProgress(Actor* actor, absl::Span<const Permit> active, absl::Span<const int64_t> steps) {
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

void LaneLedger::EndPause(Actor* actor) {
  actor->pause = absl::ZeroDuration();
  actor->pause_end = absl::InfinitePast();
}

bool LaneLedger::HasOthers(const Actor& actor) const {
  return std::any_of(actors_.begin(), actors_.end(), [&](const auto& entry) {
    return &entry.second != &actor && !entry.second.draining && entry.second.capacity > 0;
  });
}

bool LaneLedger::IsStalled(const Lane& lane, const Actor* player, const Pace& pace) const {
  if (player == nullptr || !lane.permit.has_value()) return false;
  const absl::Duration patience = options_.progress * (int64_t{1} << std::min(lane.stalls, kMaxDoublings));
  return clock_->Now() - pace.grew > patience && HasOthers(*player);
}

void LaneLedger::EndStalls() {
  std::map<Actor*, int> stalled;  // permits
  for (Lane& lane : lanes_) {
    bool stalls = false;
    // The holder twice: a backup takes its place.
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
  }
  for (auto& [name, actor] : actors_) {
    if (const auto entry = stalled.find(&actor); entry != stalled.end()) Punish(name, &actor, entry->second);
  }
}

void LaneLedger::Punish(absl::string_view name, Actor* actor, int permits) {
  actor->pause = std::clamp(2 * actor->pause, kFirstPause, kLongestPause);
  actor->pause_end = clock_->Now() + actor->pause;
  lapsed_ += permits;
  LogWarning("actor %s makes no progress: %d permits go to others, it pauses for %s", name, permits,
             absl::FormatDuration(actor->pause));
  changed_.NotifyAll();
}

void LaneLedger::GiveToOthers(Lane* lane, Actor* actor) {
  TakeBack(lane, actor);
  lane->avoided = actor;
  lane->avoided_until = clock_->Now() + options_.lease;
}

bool LaneLedger::IsAvoided(const Lane& lane, const Actor& actor, absl::Time now) const {
  return lane.avoided == &actor && now < lane.avoided_until && HasOthers(actor);
}

bool LaneLedger::IsPausing(const Actor& actor) const {
  const absl::Time now = clock_->Now();
  return (actors_.size() > 1 && now - actor.gave_back <= options_.patience) ||
         (now < actor.pause_end && HasOthers(actor));
}

absl::Duration LaneLedger::Overdue() const {
  if (times_.empty()) return absl::InfiniteDuration();
  std::vector<absl::Duration> times = times_;
  const auto middle = times.begin() + times.size() / 2;
  std::nth_element(times.begin(), middle, times.end());
  return 2 * options_.patience + 4 * *middle;
}

std::vector<Permit> LaneLedger::GrantTo(Actor* actor) {
  if (paused_ || actor->draining || IsPausing(*actor)) return {};
  const absl::Time now = clock_->Now();
  const Shares shares = FairShares();
  std::vector<Permit> granted;
  for (const Claim wanted : {Claim::kOwn, Claim::kSpare, Claim::kLeftLying}) {
    const int share = wanted == Claim::kLeftLying ? shares.Most() : shares.Of(*actor);
    int room = std::min(CapacityOf(*actor), share) - actor->permits;
    for (int l = 0; l < options_.lanes && room > 0; ++l) {
      Lane& lane = lanes_[l];
      if (lane.permit.has_value() || lane.record.next_fragment >= last_fragment_ ||
          ClaimOn(lane, *actor, shares, now) != wanted) {
        continue;
      }
      SetHolder(&lane, actor);
      lane.permit = Permit{l, lane.record.next_fragment, policy_version_};
      lane.since = now;
      lane.pace = {0, now};
      ++actor->permits;
      granted.push_back(*lane.permit);
      --room;
    }
  }
  return granted.empty() && actor->permits == 0 ? GrantBackup(actor, shares) : granted;
}

std::vector<Permit> LaneLedger::GrantBackup(Actor* actor, const Shares& shares) {
  const absl::Time now = clock_->Now();
  const int most = std::min(CapacityOf(*actor), shares.Most());
  const absl::Duration age = lapsed_ > lapsed_before_ ? std::min(options_.patience, Overdue()) : Overdue();
  std::vector<Permit> granted;
  for (Lane& lane : lanes_) {
    if (actor->permits >= most) break;
    if (!lane.permit.has_value() || lane.backup != nullptr || now - lane.since <= age) continue;
    if (IsAvoided(lane, *actor, now)) continue;
    lane.backup = actor;
    lane.backup_pace = {0, now};
    ++actor->permits;
    granted.push_back(*lane.permit);
  }
  return granted;
}

LaneLedger::Claim LaneLedger::ClaimOn(const Lane& lane, const Actor& actor, const Shares& shares,
                                      absl::Time now) const {
  if (IsAvoided(lane, actor, now)) return Claim::kNone;
  if (lane.holder == &actor) return Claim::kOwn;
  const bool spare = lane.holder == nullptr || shares.IsOver(*lane.holder);
  if (spare && actor.held < shares.Of(actor)) return Claim::kSpare;
  return now - lane.since > options_.patience ? Claim::kLeftLying : Claim::kNone;
}

int LaneLedger::CapacityOf(const Actor& actor) {
  if (actor.draining) return 0;
  return actor.pause > absl::ZeroDuration() ? std::min(actor.capacity, 1) : actor.capacity;
}

LaneLedger::Shares LaneLedger::FairShares() const {
  std::vector<int> capacities;
  capacities.reserve(actors_.size());
  for (const auto& [name, actor] : actors_) capacities.push_back(CapacityOf(actor));
  std::sort(capacities.begin(), capacities.end());
  Shares shares;
  int lanes = options_.lanes;
  auto actors = static_cast<int>(capacities.size());
  // Those that can't play a full share leave more to the others.
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
