#include "learner/lane_ledger.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/check.h"

namespace craftfleet {

namespace {

absl::Status NotKnown(absl::string_view actor) {
  return absl::AbortedError(absl::StrFormat("actor %s is not known here: join again", actor));
}

}  // namespace

LaneLedger::LaneLedger(const Options& options, std::vector<LaneRecord> lanes, Clock* clock)
    : options_(options), clock_(clock) {
  CRAFTFLEET_CHECK(static_cast<int>(lanes.size()) == options.lanes);
  for (LaneRecord& record : lanes) lanes_.push_back({std::move(record), nullptr, std::nullopt, nullptr, clock_->Now()});
}

void LaneLedger::Join(absl::string_view actor, absl::string_view address) {
  MutexLock lock(&mu_);
  ExpireLeases();
  Actor& entry = actors_[std::string(actor)];
  entry.address = std::string(address);
  entry.last_word = clock_->Now();
  entry.capacity = options_.lanes;  // until it says
}

void LaneLedger::Leave(absl::string_view actor) {
  MutexLock lock(&mu_);
  if (const auto entry = actors_.find(std::string(actor)); entry != actors_.end()) Forget(entry);
  changed_.NotifyAll();
}

void LaneLedger::LoseTouch(absl::string_view actor) {
  MutexLock lock(&mu_);
  const auto entry = actors_.find(std::string(actor));
  if (entry == actors_.end()) return;
  entry->second.last_word = std::min(entry->second.last_word, clock_->Now() - options_.lease + options_.comeback);
}

absl::StatusOr<LaneLedger::Grant> LaneLedger::GetPermits(absl::string_view actor_name, absl::Span<const Permit> active,
                                                         int capacity, absl::Duration wait) {
  const std::string name(actor_name);
  MutexLock lock(&mu_);
  auto known = actors_.find(name);
  // Late, but nobody asked for its lanes in the meantime.
  if (known != actors_.end() && clock_->Now() - known->second.last_word <= 2 * options_.lease) {
    known->second.last_word = clock_->Now();
  }
  ExpireLeases();
  known = actors_.find(name);
  if (known == actors_.end()) return NotKnown(name);
  known->second.capacity = std::clamp(capacity, 0, options_.lanes);

  Grant grant;
  grant.lost = Renew(&known->second, active);
  changed_.WaitFor(&mu_, wait, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    const auto still = actors_.find(name);
    if (still == actors_.end() || closed_) return true;
    grant.granted = GrantTo(&still->second);
    return !grant.granted.empty() || !grant.lost.empty() || finished_;
  });
  if (closed_) return absl::UnavailableError("the learner is stopping");
  grant.finished = finished_;
  known = actors_.find(name);
  if (known == actors_.end()) return NotKnown(name);
  grant.resting = paused_ || known->second.draining;
  known->second.last_word = clock_->Now();
  return grant;
}

absl::StatusOr<LaneLedger::Verdict> LaneLedger::Accept(absl::string_view actor, const Permit& fragment,
                                                       const LaneSnapshot& snapshot) {
  MutexLock lock(&mu_);
  CRAFTFLEET_CHECK(fragment.lane >= 0 && fragment.lane < options_.lanes);
  Lane& lane = lanes_[fragment.lane];
  if (fragment.fragment < lane.record.next_fragment) return Verdict::kDuplicate;
  const auto sender = actors_.find(std::string(actor));
  if (sender == actors_.end() || !IsPlayer(lane, &sender->second) || !lane.permit.has_value() ||
      lane.permit->fragment != fragment.fragment) {
    return Verdict::kExpired;
  }
  if (fragment.policy_version != lane.permit->policy_version) {
    return absl::InvalidArgumentError(absl::StrFormat("policy_version %d for fragment %d of lane %d, want %d",
                                                      fragment.policy_version, fragment.fragment, fragment.lane,
                                                      lane.permit->policy_version));
  }
  EndPermit(&lane);
  SetHolder(&lane, sender->second.draining ? nullptr : &sender->second);
  lane.record.next_fragment = fragment.fragment + 1;
  lane.record.snapshot = snapshot;
  ++sender->second.fragments;
  sender->second.last_word = clock_->Now();
  if (lane.record.next_fragment < last_fragment_) changed_.NotifyAll();
  return Verdict::kAccepted;
}

bool LaneLedger::Restore(const Permit& fragment, const LaneSnapshot& snapshot) {
  MutexLock lock(&mu_);
  CRAFTFLEET_CHECK(fragment.lane >= 0 && fragment.lane < options_.lanes);
  LaneRecord& record = lanes_[fragment.lane].record;
  if (record.next_fragment != fragment.fragment || lanes_[fragment.lane].permit.has_value()) return false;
  record = {fragment.fragment + 1, snapshot};
  return true;
}

absl::StatusOr<LaneSnapshot> LaneLedger::Snapshot(int lane, int64_t fragment) const {
  MutexLock lock(&mu_);
  if (lane < 0 || lane >= options_.lanes) {
    return absl::InvalidArgumentError(absl::StrFormat("lane %d, want 0..%d", lane, options_.lanes - 1));
  }
  const LaneRecord& record = lanes_[lane].record;
  if (record.next_fragment != fragment) {
    return absl::AbortedError(absl::StrFormat("lane %d is at fragment %d, not %d: ask for permits again", lane,
                                              record.next_fragment, fragment));
  }
  return record.snapshot;
}

void LaneLedger::OpenIteration(int64_t last_fragment, int64_t policy_version) {
  MutexLock lock(&mu_);
  last_fragment_ = last_fragment;
  policy_version_ = policy_version;
  lapsed_before_ = lapsed_;
  for (Lane& lane : lanes_) lane.since = clock_->Now();
  changed_.NotifyAll();
}

void LaneLedger::Finish() {
  MutexLock lock(&mu_);
  finished_ = true;
  changed_.NotifyAll();
}

void LaneLedger::Close() {
  MutexLock lock(&mu_);
  closed_ = true;
  changed_.NotifyAll();
}

bool LaneLedger::SetPaused(bool paused) {
  MutexLock lock(&mu_);
  const bool before = paused_;
  paused_ = paused;
  // Nobody left them lying.
  for (Lane& lane : lanes_) lane.since = clock_->Now();
  changed_.NotifyAll();
  return before;
}

bool LaneLedger::paused() const {
  MutexLock lock(&mu_);
  return paused_;
}

void LaneLedger::Drain(absl::string_view actor) {
  MutexLock lock(&mu_);
  const auto entry = actors_.find(std::string(actor));
  if (entry == actors_.end()) return;
  entry->second.draining = true;
  for (Lane& lane : lanes_) {
    if (lane.holder == &entry->second && !lane.permit.has_value()) SetHolder(&lane, nullptr);
  }
  changed_.NotifyAll();
}

bool LaneLedger::IsDrained(absl::string_view actor) const {
  MutexLock lock(&mu_);
  const auto entry = actors_.find(std::string(actor));
  return entry == actors_.end() || (entry->second.draining && entry->second.permits == 0);
}

int LaneLedger::permits() const {
  MutexLock lock(&mu_);
  int permits = 0;
  for (const auto& [name, actor] : actors_) permits += actor.permits;
  return permits;
}

void LaneLedger::WaitUntilEmpty(absl::Duration timeout) {
  MutexLock lock(&mu_);
  changed_.WaitFor(&mu_, timeout, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return actors_.empty(); });
}

std::vector<LaneRecord> LaneLedger::Records() const {
  MutexLock lock(&mu_);
  std::vector<LaneRecord> records;
  for (const Lane& lane : lanes_) records.push_back(lane.record);
  return records;
}

std::vector<LaneLedger::ActorInfo> LaneLedger::Actors() const {
  MutexLock lock(&mu_);
  std::vector<ActorInfo> infos;
  for (const auto& [name, actor] : actors_) {
    infos.push_back(
        {name, actor.address, actor.permits, actor.fragments, clock_->Now() - actor.last_word, actor.draining});
  }
  return infos;
}

int64_t LaneLedger::lapsed() const {
  MutexLock lock(&mu_);
  return lapsed_;
}

void LaneLedger::ExpireLeases() {
  const absl::Time now = clock_->Now();
  for (auto actor = actors_.begin(); actor != actors_.end();) {
    const auto next = std::next(actor);
    if (now - actor->second.last_word > options_.lease) {
      lapsed_ += actor->second.permits;
      Forget(actor);
      changed_.NotifyAll();
    }
    actor = next;
  }
}

void LaneLedger::Forget(std::map<std::string, Actor>::iterator actor) {
  for (Lane& lane : lanes_) {
    if (lane.permit.has_value()) TakeBack(&lane, &actor->second);
    if (lane.holder == &actor->second) SetHolder(&lane, nullptr);
  }
  actors_.erase(actor);
}

std::vector<Permit> LaneLedger::Renew(Actor* actor, absl::Span<const Permit> active) {
  for (Lane& lane : lanes_) {
    if (!IsPlayer(lane, actor) || !lane.permit.has_value()) continue;
    if (std::find(active.begin(), active.end(), *lane.permit) != active.end()) continue;
    TakeBack(&lane, actor);
    actor->gave_back = clock_->Now();
    changed_.NotifyAll();
  }
  std::vector<Permit> lost;
  for (const Permit& permit : active) {
    const bool in_range = permit.lane >= 0 && permit.lane < options_.lanes;
    // An accepted fragment's permit is not lost: its verdict is on the way.
    if (in_range && permit.fragment < lanes_[permit.lane].record.next_fragment) continue;
    if (!in_range || !IsPlayer(lanes_[permit.lane], actor) || lanes_[permit.lane].permit != permit) {
      lost.push_back(permit);
    }
  }
  return lost;
}

bool LaneLedger::IsPausing(const Actor& actor) const {
  return actors_.size() > 1 && clock_->Now() - actor.gave_back <= options_.patience;
}

std::vector<Permit> LaneLedger::GrantTo(Actor* actor) {
  if (paused_ || actor->draining || IsPausing(*actor)) return {};
  const absl::Time now = clock_->Now();
  const Shares shares = FairShares();
  std::vector<Permit> granted;
  for (const Claim wanted : {Claim::kOwn, Claim::kSpare, Claim::kLeftLying}) {
    const int share = wanted == Claim::kLeftLying ? shares.Most() : shares.Of(*actor);
    int room = std::min(actor->capacity, share) - actor->permits;
    for (int l = 0; l < options_.lanes && room > 0; ++l) {
      Lane& lane = lanes_[l];
      if (lane.permit.has_value() || lane.record.next_fragment >= last_fragment_ ||
          ClaimOn(lane, *actor, shares, now) != wanted) {
        continue;
      }
      SetHolder(&lane, actor);
      lane.permit = Permit{l, lane.record.next_fragment, policy_version_};
      lane.since = now;
      ++actor->permits;
      granted.push_back(*lane.permit);
      --room;
    }
  }
  return granted.empty() && actor->permits == 0 && lapsed_ > lapsed_before_ ? GrantBackup(actor, shares) : granted;
}

std::vector<Permit> LaneLedger::GrantBackup(Actor* actor, const Shares& shares) {
  const absl::Time now = clock_->Now();
  const int most = std::min(actor->capacity, shares.Most());
  std::vector<Permit> granted;
  for (Lane& lane : lanes_) {
    if (actor->permits >= most) break;
    if (!lane.permit.has_value() || lane.backup != nullptr || now - lane.since <= options_.patience) continue;
    lane.backup = actor;
    ++actor->permits;
    granted.push_back(*lane.permit);
  }
  return granted;
}

LaneLedger::Claim LaneLedger::ClaimOn(const Lane& lane, const Actor& actor, const Shares& shares,
                                      absl::Time now) const {
  if (lane.holder == &actor) return Claim::kOwn;
  const bool spare = lane.holder == nullptr || shares.IsOver(*lane.holder);
  if (spare && actor.held < shares.Of(actor)) return Claim::kSpare;
  return now - lane.since > options_.patience ? Claim::kLeftLying : Claim::kNone;
}

LaneLedger::Shares LaneLedger::FairShares() const {
  std::vector<int> capacities;
  capacities.reserve(actors_.size());
  for (const auto& [name, actor] : actors_) capacities.push_back(actor.draining ? 0 : actor.capacity);
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

void LaneLedger::SetHolder(Lane* lane, Actor* actor) {
  if (lane->holder != nullptr) --lane->holder->held;
  if (actor != nullptr) ++actor->held;
  lane->holder = actor;
}

void LaneLedger::EndPermit(Lane* lane) {
  --lane->holder->permits;
  if (lane->backup != nullptr) --lane->backup->permits;
  lane->backup = nullptr;
  lane->permit.reset();
  lane->since = clock_->Now();
}

void LaneLedger::TakeBack(Lane* lane, Actor* actor) {
  if (!IsPlayer(*lane, actor)) return;
  if (lane->backup == nullptr) {
    EndPermit(lane);
    SetHolder(lane, nullptr);
    lane->since = absl::InfinitePast();  // anybody may have it at once
    return;
  }
  --actor->permits;
  if (lane->holder == actor) SetHolder(lane, lane->backup);
  lane->backup = nullptr;
}

}  // namespace craftfleet
