// LaneScheduler: grants permits, and overdue ones once more.
#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "common/telemetry/log.h"
#include "learner/scheduling/lane_scheduler.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kFirstPause = absl::Seconds(1);
constexpr absl::Duration kLongestPause = absl::Minutes(5);

}  // namespace

void LaneScheduler::EndPause(Actor* actor) {
  if (actor->pause == absl::ZeroDuration()) return;
  actor->pause = absl::ZeroDuration();
  actor->pause_end = absl::InfinitePast();
  shares_.reset();
}

bool LaneScheduler::CanPlay(const Actor& actor) const {
  return !actor.worker->draining && actor.capacity > 0 && clock_->Now() >= actor.pause_end;
}

bool LaneScheduler::HasOthers(const Actor& actor) const {
  return std::any_of(actors_.begin(), actors_.end(),
                     [&](const auto& entry) { return &entry.second != &actor && CanPlay(entry.second); });
}

bool LaneScheduler::HasOtherClients(const Actor& actor) const {
  return std::any_of(actors_.begin(), actors_.end(), [&](const auto& entry) {
    return entry.second.worker->client.Name() != actor.worker->client.Name() && CanPlay(entry.second);
  });
}

void LaneScheduler::PauseLate(const Lane& lane, const Actor& sender) {
  const absl::Time now = clock_->Now();
  for (const Player& player : lane.players) {
    Actor* const actor = player.actor;
    if (actor == &sender || now - player.since <= overdue_.Limit()) continue;
    ++lapsed_;
    change_.all = true;
    if (now < actor->pause_end) continue;  // for another of its lanes
    actor->pause = std::clamp(2 * actor->pause, kFirstPause, kLongestPause);
    actor->pause_end = now + actor->pause;
    shares_.reset();
    LogWarning("actor %s has had fragment %d of lane %d for %s: actor %s finished it; no new ones for %s",
               actor->worker->name, lane.permit->fragment, lane.permit->lane,
               absl::FormatDuration(absl::Trunc(now - player.since, absl::Milliseconds(100))), sender.worker->name,
               absl::FormatDuration(actor->pause));
  }
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

bool LaneScheduler::HasJustReturned(const Actor& actor) const {
  return actors_.size() > 1 && clock_->Now() - actor.returned <= options_.patience;
}

std::vector<Permit> LaneScheduler::Grant(absl::string_view actor_name) {
  Actor* const actor = &actors_.find(actor_name)->second;
  if (paused_ || actor->worker->draining || HasJustReturned(*actor)) return {};
  const absl::Time now = clock_->Now();
  const Shares shares = FairShares();
  if (now < actor->pause_end && HasOthers(*actor)) return GrantOverdue(actor, shares);
  int64_t ahead = Ahead();
  std::vector<Permit> granted;
  for (const Claim wanted : {Claim::kOwn, Claim::kSpare, Claim::kUnclaimed}) {
    const int share = wanted == Claim::kUnclaimed ? shares.Most() : shares.Of(*actor);
    int room = std::min(CapacityOf(*actor), share) - static_cast<int>(actor->permits.size());
    if (room <= 0 || ahead <= 0) continue;
    for (Lane& lane : lanes_) {
      if (room <= 0 || ahead <= 0) break;
      if (!lane.IsOpen() || ClaimOn(lane, *actor, shares, now) != wanted) continue;
      SetHolder(&lane, actor);
      const int l = NumberOf(lane);
      lane.permit = Permit{l, lane.record.next_fragment, policy_version_, lane.reset_at == lane.record.next_fragment};
      lane.since = now;
      lane.players = {{actor, now}};
      actor->permits.insert(l);
      ++playing_;
      granted.push_back(*lane.permit);
      --room;
      --ahead;
    }
  }
  return granted.empty() ? GrantOverdue(actor, shares) : granted;
}

std::vector<Permit> LaneScheduler::GrantOverdue(Actor* actor, const Shares& shares) {
  const absl::Time now = clock_->Now();
  // Asynchronous play leaves no actor without work.
  const bool is_asynchronous = options_.max_staleness > 0;
  const int most = is_asynchronous ? CapacityOf(*actor) : std::min(CapacityOf(*actor), shares.Most());
  std::vector<Permit> granted;
  if (!is_asynchronous && !actor->permits.empty()) return granted;
  for (Lane& lane : lanes_) {
    if (static_cast<int>(actor->permits.size()) >= most) break;
    const absl::Duration age = now - lane.since;
    if (!lane.permit.has_value() || age <= overdue_.Limit()) continue;
    const bool is_its_turn = age > overdue_.Limit() + options_.patience || IsPreferred(lane, *actor);
    if (!is_its_turn || IsPlayer(lane, actor) || IsAvoided(lane, *actor, now)) continue;
    const Player& last = lane.players.back();
    LogInfo("actor %s has had fragment %d of lane %d for %s: actor %s plays it too", last.actor->worker->name,
            lane.permit->fragment, lane.permit->lane,
            absl::FormatDuration(absl::Trunc(now - last.since, absl::Milliseconds(100))), actor->worker->name);
    lane.players.push_back({actor, now});
    lane.since = now;
    actor->permits.insert(lane.permit->lane);
    granted.push_back(*lane.permit);
  }
  return granted;
}

bool LaneScheduler::IsPreferred(const Lane& lane, const Actor& actor) const {
  if (actor.pause > absl::ZeroDuration()) return false;
  const std::string& client = actor.worker->client.Name();
  const bool is_other = std::none_of(lane.players.begin(), lane.players.end(), [&](const Player& player) {
    return player.actor->worker->client.Name() == client;
  });
  return is_other || !HasOtherClients(actor);
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

const LaneScheduler::Shares& LaneScheduler::FairShares() const {
  if (shares_.has_value()) return *shares_;
  std::vector<int> capacities;
  for (const auto& [name, actor] : actors_) capacities.push_back(CapacityOf(actor));
  std::sort(capacities.begin(), capacities.end());
  Shares shares;
  int lanes = options_.lanes;
  auto actors = static_cast<int>(actors_.size());
  // If an actor can't play a full share, the others get more.
  for (const int capacity : capacities) {
    shares.all = lanes / actors;
    shares.extra = lanes % actors;
    if (capacity > shares.all) break;
    lanes -= capacity;
    --actors;
  }
  for (const auto& [name, actor] : actors_) shares.above += actor.held() > shares.all ? 1 : 0;
  return shares_.emplace(shares);
}

}  // namespace craftfleet
