#include "learner/scheduling/assignment.h"

#include <algorithm>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kFirstPause = absl::Seconds(1);
constexpr absl::Duration kLongestPause = absl::Minutes(5);

std::string Rounded(absl::Duration time) { return absl::FormatDuration(absl::Trunc(time, absl::Milliseconds(100))); }

}  // namespace

std::vector<Permit> Assignment::Grant(int64_t policy_version, int64_t ahead, LaneActor* actor) {
  if (paused_ || actor->worker->draining || HasJustReturned(*actor)) return {};
  const absl::Time now = clock_->Now();
  if (now < actor->pause_end && HasOthers(*actor)) return GrantOverdue(actor);
  const Shares shares = FairShares();  // those before the grants
  std::vector<Permit> granted;
  for (const Claim wanted : {Claim::kOwn, Claim::kSpare, Claim::kUnclaimed}) {
    const int share = wanted == Claim::kUnclaimed ? shares.Most() : shares.Of(*actor);
    int room = std::min(CapacityOf(*actor), share) - static_cast<int>(actor->permits.size());
    for (LaneState& lane : table_->lanes()) {
      if (room <= 0 || ahead <= 0) break;
      if (!lane.IsOpen() || ClaimOn(lane, *actor, shares, now) != wanted) continue;
      granted.push_back(table_->Grant(actor, policy_version, &lane));
      --room;
      --ahead;
    }
  }
  return granted.empty() ? GrantOverdue(actor) : granted;
}

std::vector<Permit> Assignment::GrantOverdue(LaneActor* actor) {
  std::vector<Permit> granted;
  if (!is_asynchronous_ && !actor->permits.empty()) return granted;
  // Asynchronous play leaves no actor without work.
  const int capacity = CapacityOf(*actor);
  const int most = is_asynchronous_ ? capacity : std::min(capacity, FairShares().Most());
  const absl::Time now = clock_->Now();
  std::string first;  // of those granted
  for (LaneState& lane : table_->lanes()) {
    if (static_cast<int>(actor->permits.size()) >= most) break;
    const absl::Duration age = now - lane.since;
    if (!lane.permit.has_value() || age <= overdue_.Limit()) continue;
    const bool is_its_turn = age > overdue_.Limit() + kPatience || IsPreferred(lane, *actor);
    if (!is_its_turn || lane.IsPlayedBy(*actor) || IsAvoided(lane, *actor, now)) continue;
    const LaneState::Player& last = lane.players.back();
    if (granted.empty()) {
      first = absl::StrFormat("fragment %d of lane %d, which actor %s has had for %s", lane.permit->fragment,
                              lane.number, last.actor->worker->name, Rounded(now - last.since));
    }
    granted.push_back(table_->AddPlayer(actor, &lane));
  }
  if (!granted.empty()) {
    const std::string more = granted.size() == 1 ? "" : absl::StrCat(", and ", granted.size() - 1, " more");
    LogInfo("actor %s also plays %s%s", actor->worker->name, first, more);
  }
  return granted;
}

bool Assignment::IsPreferred(const LaneState& lane, const LaneActor& actor) const {
  if (actor.pause > absl::ZeroDuration()) return false;
  const std::string& client = actor.worker->client.Name();
  const bool is_other = std::none_of(lane.players.begin(), lane.players.end(), [&](const LaneState::Player& player) {
    return player.actor->worker->client.Name() == client;
  });
  return is_other || !HasOtherClients(actor);
}

Assignment::Claim Assignment::ClaimOn(const LaneState& lane, const LaneActor& actor, const Shares& shares,
                                      absl::Time now) const {
  if (IsAvoided(lane, actor, now)) return Claim::kNone;
  if (lane.holder == &actor) return Claim::kOwn;
  const bool spare = lane.holder == nullptr || shares.IsOver(*lane.holder);
  if (spare && actor.held() < shares.Of(actor)) return Claim::kSpare;
  return now - lane.since > kPatience ? Claim::kUnclaimed : Claim::kNone;
}

const Assignment::Shares& Assignment::FairShares() {
  if (shares_of_ == table_->shares()) return shares_;
  shares_of_ = table_->shares();
  std::vector<int> capacities;
  for (const auto& [name, actor] : table_->actors()) capacities.push_back(CapacityOf(actor));
  std::sort(capacities.begin(), capacities.end());
  shares_ = {};
  int lanes = table_->size();
  auto actors = static_cast<int>(capacities.size());
  // If an actor can't play a full share, the others get more.
  for (const int capacity : capacities) {
    shares_.all = lanes / actors;
    shares_.extra = lanes % actors;
    if (capacity > shares_.all) break;
    lanes -= capacity;
    --actors;
  }
  for (const auto& [name, actor] : table_->actors()) shares_.above += actor.held() > shares_.all ? 1 : 0;
  return shares_;
}

void Assignment::OnPlayed(LaneActor* sender, LaneState* lane) {
  PauseLate(*lane, *sender);
  for (const LaneState::Player& player : lane->players) {
    if (player.actor == sender) overdue_.Add(clock_->Now() - player.since);
  }
  table_->EndPermit(lane);
  table_->SetHolder(sender->worker->draining ? nullptr : sender, lane);
  lane->avoided.clear();
  if (sender->pause == absl::ZeroDuration()) return;
  sender->pause = absl::ZeroDuration();
  sender->pause_end = absl::InfinitePast();
  table_->NoteShares();
}

void Assignment::PauseLate(const LaneState& lane, const LaneActor& sender) {
  const absl::Time now = clock_->Now();
  for (const LaneState::Player& player : lane.players) {
    LaneActor* const actor = player.actor;
    if (actor == &sender || now - player.since <= overdue_.Limit()) continue;
    ++table_->counters.lapsed;
    table_->NoteChange();
    if (now < actor->pause_end) continue;  // for another of its lanes
    actor->pause = std::clamp(2 * actor->pause, kFirstPause, kLongestPause);
    actor->pause_end = now + actor->pause;
    table_->NoteShares();
    LogWarning("actor %s has had fragment %d of lane %d for %s: actor %s finished it; no new ones for %s",
               actor->worker->name, lane.permit->fragment, lane.number, Rounded(now - player.since),
               sender.worker->name, absl::FormatDuration(actor->pause));
  }
}

void Assignment::GiveToOthers(LaneActor* actor, LaneState* lane) {
  table_->Revoke(actor, lane);
  lane->avoided = actor->worker->name;
  lane->avoided_until = clock_->Now() + avoidance_;
}

bool Assignment::SetPaused(bool paused) {
  const bool before = paused_;
  paused_ = paused;
  // Time in the pause must not count as time unclaimed.
  for (LaneState& lane : table_->lanes()) lane.since = clock_->Now();
  table_->NoteChange();
  return before;
}

int Assignment::CapacityOf(const LaneActor& actor) {
  if (actor.worker->draining) return 0;
  return actor.pause > absl::ZeroDuration() ? std::min(actor.capacity, 1) : actor.capacity;
}

bool Assignment::CanPlay(const LaneActor& actor) const {
  return !actor.worker->draining && actor.capacity > 0 && clock_->Now() >= actor.pause_end;
}

bool Assignment::HasOthers(const LaneActor& actor) const {
  const LaneTable::ActorMap& actors = table_->actors();
  return std::any_of(actors.begin(), actors.end(),
                     [&](const auto& entry) { return &entry.second != &actor && CanPlay(entry.second); });
}

bool Assignment::HasOtherClients(const LaneActor& actor) const {
  const LaneTable::ActorMap& actors = table_->actors();
  return std::any_of(actors.begin(), actors.end(), [&](const auto& entry) {
    return entry.second.worker->client.Name() != actor.worker->client.Name() && CanPlay(entry.second);
  });
}

bool Assignment::HasJustReturned(const LaneActor& actor) const {
  return table_->actors().size() > 1 && clock_->Now() - actor.returned <= kPatience;
}

bool Assignment::IsAvoided(const LaneState& lane, const LaneActor& actor, absl::Time now) const {
  if (now >= lane.avoided_until) return false;
  const bool has_reported = lane.report.has_value() && lane.report->client == actor.worker->client.Name();
  return (lane.avoided == actor.worker->name && HasOthers(actor)) || (has_reported && HasOtherClients(actor));
}

}  // namespace craftfleet
