#include "learner/scheduling/lane_table.h"

#include <algorithm>
#include <utility>

#include <absl/status/status.h>
#include <absl/strings/str_format.h>

#include "common/base/check.h"
#include "common/telemetry/log.h"

namespace craftfleet {

bool LaneState::IsPlayedBy(const LaneActor& actor) const {
  return std::any_of(players.begin(), players.end(), [&](const Player& player) { return player.actor == &actor; });
}

LaneTable::LaneTable(std::vector<LaneRecord> records, Clock* clock) : clock_(clock) {
  for (LaneRecord& record : records) {
    LaneState& lane = lanes_.emplace_back();
    lane.number = static_cast<int>(lanes_.size()) - 1;
    lane.start = record;
    lane.record = std::move(record);
    lane.since = clock_->Now();
  }
}

LaneActor* LaneTable::Find(absl::string_view actor) {
  const auto entry = actors_.find(actor);
  return entry == actors_.end() ? nullptr : &entry->second;
}

const LaneActor* LaneTable::Find(absl::string_view actor) const {
  const auto entry = actors_.find(actor);
  return entry == actors_.end() ? nullptr : &entry->second;
}

LaneActor* LaneTable::Add(const Worker* worker) {
  LaneActor& actor = actors_[worker->name];
  actor.worker = worker;
  SetCapacity(&actor, size());  // until it reports its own
  NoteShares();
  return &actor;
}

void LaneTable::Remove(LaneActor* actor) {
  for (const int l : std::vector<int>(actor->permits.begin(), actor->permits.end())) Revoke(actor, &lanes_[l]);
  for (const int l : std::vector<int>(actor->lanes.begin(), actor->lanes.end())) SetHolder(nullptr, &lanes_[l]);
  actors_.erase(actors_.find(actor->worker->name));
  NoteShares();
  NoteChange();
}

void LaneTable::SetCapacity(LaneActor* actor, int capacity) {
  capacity = std::clamp(capacity, 0, size());
  if (std::exchange(actor->capacity, capacity) != capacity) NoteShares();
}

Permit LaneTable::Grant(LaneActor* actor, int64_t policy_version, LaneState* lane) {
  SetHolder(actor, lane);
  lane->permit = Permit{lane->number, lane->record.next_fragment, policy_version};
  lane->players.clear();
  return AddPlayer(actor, lane);
}

Permit LaneTable::AddPlayer(LaneActor* actor, LaneState* lane) {
  lane->since = clock_->Now();
  lane->players.push_back({actor, lane->since});
  actor->permits.insert(lane->number);
  Permit permit = *lane->permit;
  // Another actor may have played the last fragment as well, with older weights (max_staleness): its game is another.
  const std::string& sender = lane->record.sender;
  permit.reload = lane->reset_at == permit.fragment || (!sender.empty() && sender != actor->worker->name);
  return permit;
}

void LaneTable::Revoke(LaneActor* actor, LaneState* lane) {
  if (!lane->IsPlayedBy(*actor)) return;
  if (lane->players.size() == 1) {
    EndPermit(lane);
    SetHolder(nullptr, lane);
    lane->since = absl::InfinitePast();  // free for any actor at once
    return;
  }
  actor->permits.erase(lane->number);
  std::vector<LaneState::Player>& players = lane->players;
  players.erase(
      std::find_if(players.begin(), players.end(), [&](const auto& player) { return player.actor == actor; }));
  SetHolder(players.front().actor, lane);
  lane->since = players.back().since;
}

void LaneTable::EndPermit(LaneState* lane) {
  for (const LaneState::Player& player : lane->players) player.actor->permits.erase(lane->number);
  lane->players.clear();
  lane->permit.reset();
  lane->since = clock_->Now();
}

void LaneTable::SetHolder(LaneActor* actor, LaneState* lane) {
  if (lane->holder == actor) return;
  if (lane->holder != nullptr) lane->holder->lanes.erase(lane->number);
  if (actor != nullptr) actor->lanes.insert(lane->number);
  lane->holder = actor;
  NoteShares();
}

void LaneTable::Compare(absl::string_view actor, const Permit& fragment, uint64_t digest) {
  if (Find(actor) == nullptr) return;
  for (LaneState::AcceptedFragment& accepted : lanes_[fragment.lane].accepted) {
    if (accepted.fragment != fragment.fragment || accepted.digest == digest) continue;
    // With max_staleness the permit may have lapsed, and another actor got one with newer weights.
    if (accepted.policy_version != fragment.policy_version) continue;
    ++counters.differing;
    if (std::exchange(accepted.differs, true)) continue;
    LogError(
        "fragment %d of lane %d: actor %s sent %016x, which was accepted, and actor %s sent %016x; they should be "
        "equal: compare their programs and CPUs",
        fragment.fragment, fragment.lane, accepted.sender, accepted.digest, actor, digest);
  }
}

void LaneTable::Advance(int64_t policy_version, const SharedSnapshot& snapshot, uint64_t digest,
                        const std::string& sender, LaneState* lane) {
  const int64_t fragment = lane->record.next_fragment;
  lane->record = {fragment + 1, snapshot, std::move(lane->record.snapshot), sender};
  lane->accepted.push_back({fragment, policy_version, digest, sender});
}

void LaneTable::Rewind(LaneState* lane) {
  lane->record = lane->start;
  while (!lane->accepted.empty() && lane->accepted.back().fragment >= lane->start.next_fragment) {
    lane->accepted.pop_back();
  }
  lane->report.reset();
}

bool LaneTable::Counts(int lane, int64_t fragment, uint64_t digest) const {
  const std::deque<LaneState::AcceptedFragment>& accepted = lanes_[lane].accepted;
  return std::any_of(accepted.begin(), accepted.end(), [&](const LaneState::AcceptedFragment& t) {
    return t.fragment == fragment && t.digest == digest;
  });
}

bool LaneTable::IsAcceptedFrom(absl::string_view actor, const Permit& fragment) const {
  const std::deque<LaneState::AcceptedFragment>& accepted = lanes_[fragment.lane].accepted;
  return std::any_of(accepted.begin(), accepted.end(), [&](const LaneState::AcceptedFragment& t) {
    return t.fragment == fragment.fragment && t.sender == actor;
  });
}

absl::StatusOr<LaneSnapshot> LaneTable::Snapshot(int lane, int64_t fragment) const {
  if (lane < 0 || lane >= size()) {
    return absl::InvalidArgumentError(absl::StrFormat("lane %d, want 0..%d", lane, size() - 1));
  }
  const LaneRecord& record = lanes_[lane].record;
  if (record.next_fragment != fragment) {
    return absl::AbortedError(absl::StrFormat("lane %d is at fragment %d, not %d: request permits again", lane,
                                              record.next_fragment, fragment));
  }
  return *record.snapshot;
}

std::vector<LaneRecord> LaneTable::Records(LaneRecord LaneState::*when) const {
  std::vector<LaneRecord> records;
  for (const LaneState& lane : lanes_) records.push_back(lane.*when);
  return records;
}

LaneTable::ActorInfo LaneTable::InfoOf(absl::string_view actor) const {
  const LaneActor& found = *Find(actor);
  return {static_cast<int>(found.permits.size()), found.fragments, found.pause > absl::ZeroDuration()};
}

int LaneTable::playing() const {
  return static_cast<int>(
      std::count_if(lanes_.begin(), lanes_.end(), [](const LaneState& lane) { return lane.permit.has_value(); }));
}

std::vector<LaneTable::Playing> LaneTable::BeingPlayed() const {
  std::vector<Playing> playing;
  for (const LaneState& lane : lanes_) {
    if (!lane.permit.has_value()) continue;
    Playing& one = playing.emplace_back(Playing{*lane.permit, {}});
    for (const LaneState::Player& player : lane.players) {
      one.actors.emplace_back(player.actor->worker->name, clock_->Now() - player.since);
    }
  }
  std::stable_sort(playing.begin(), playing.end(), [](const Playing& a, const Playing& b) {
    return a.actors.front().second > b.actors.front().second;
  });
  return playing;
}

}  // namespace craftfleet
