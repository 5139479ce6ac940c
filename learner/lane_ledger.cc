#include "learner/lane_ledger.h"

#include <algorithm>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/check.h"

namespace craftfleet {

LaneLedger::LaneLedger(const Options& options, std::vector<LaneRecord> lanes, Clock* clock)
    : options_(options), clock_(clock) {
  CRAFTFLEET_CHECK(static_cast<int>(lanes.size()) == options.lanes);
  for (LaneRecord& record : lanes) lanes_.push_back({std::move(record), "", std::nullopt});
}

void LaneLedger::Join(absl::string_view actor, absl::string_view address) {
  MutexLock lock(&mu_);
  Actor& entry = actors_[std::string(actor)];
  entry.address = std::string(address);
  entry.last_word = clock_->Now();
}

void LaneLedger::Leave(absl::string_view actor) {
  MutexLock lock(&mu_);
  Forget(std::string(actor));
  changed_.NotifyAll();
}

absl::StatusOr<LaneLedger::Grant> LaneLedger::GetPermits(absl::string_view actor_name, absl::Span<const Permit> active,
                                                         int capacity, absl::Duration wait) {
  const std::string actor(actor_name);
  MutexLock lock(&mu_);
  const auto known = actors_.find(actor);
  if (known != actors_.end()) known->second.last_word = clock_->Now();
  ExpireLeases();
  if (known == actors_.end())
    return absl::AbortedError(absl::StrFormat("actor %s is not known here: join again", actor));

  Grant grant;
  grant.lost = Renew(actor, active);
  changed_.WaitFor(&mu_, wait, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    if (actors_.count(actor) == 0) return true;
    grant.granted = GrantTo(actor, capacity);
    return !grant.granted.empty() || !grant.lost.empty() || finished_;
  });
  grant.finished = finished_;
  if (const auto still = actors_.find(actor); still != actors_.end()) still->second.last_word = clock_->Now();
  return grant;
}

absl::StatusOr<LaneLedger::Verdict> LaneLedger::Accept(absl::string_view actor, const Permit& fragment,
                                                       const LaneSnapshot& snapshot) {
  MutexLock lock(&mu_);
  CRAFTFLEET_CHECK(fragment.lane >= 0 && fragment.lane < options_.lanes);
  Lane& lane = lanes_[fragment.lane];
  if (fragment.fragment < lane.record.next_fragment) return Verdict::kDuplicate;
  if (!lane.permit.has_value() || lane.holder != actor || lane.permit->fragment != fragment.fragment) {
    return Verdict::kExpired;
  }
  if (fragment.policy_version != lane.permit->policy_version) {
    return absl::InvalidArgumentError(absl::StrFormat("policy_version %d for fragment %d of lane %d, want %d",
                                                      fragment.policy_version, fragment.fragment, fragment.lane,
                                                      lane.permit->policy_version));
  }
  lane.permit.reset();
  lane.record.next_fragment = fragment.fragment + 1;
  lane.record.snapshot = snapshot;
  if (const auto entry = actors_.find(lane.holder); entry != actors_.end()) {
    ++entry->second.fragments;
    entry->second.last_word = clock_->Now();
  }
  changed_.NotifyAll();
  return Verdict::kAccepted;
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
  opened_ = clock_->Now();
  changed_.NotifyAll();
}

void LaneLedger::Finish() {
  MutexLock lock(&mu_);
  finished_ = true;
  changed_.NotifyAll();
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
    infos.push_back({name, actor.address, PermitsOf(name), actor.fragments, clock_->Now() - actor.last_word});
  }
  return infos;
}

void LaneLedger::ExpireLeases() {
  const absl::Time now = clock_->Now();
  std::vector<std::string> gone;
  for (const auto& [name, actor] : actors_) {
    if (now - actor.last_word > options_.lease) gone.push_back(name);
  }
  for (const std::string& name : gone) Forget(name);
}

void LaneLedger::Forget(const std::string& actor) {
  actors_.erase(actor);
  for (Lane& lane : lanes_) {
    if (lane.holder != actor) continue;
    lane.holder.clear();
    lane.permit.reset();
  }
}

std::vector<Permit> LaneLedger::Renew(const std::string& actor, absl::Span<const Permit> active) {
  for (Lane& lane : lanes_) {
    if (lane.holder != actor || !lane.permit.has_value()) continue;
    if (std::find(active.begin(), active.end(), *lane.permit) != active.end()) continue;
    lane.permit.reset();
    lane.holder.clear();
    actors_[actor].gave_back = clock_->Now();
    changed_.NotifyAll();
  }
  std::vector<Permit> lost;
  for (const Permit& permit : active) {
    const bool in_range = permit.lane >= 0 && permit.lane < options_.lanes;
    // An accepted fragment's permit is not lost: its verdict is on the way.
    if (in_range && permit.fragment < lanes_[permit.lane].record.next_fragment) continue;
    if (!in_range || lanes_[permit.lane].holder != actor || lanes_[permit.lane].permit != permit)
      lost.push_back(permit);
  }
  return lost;
}

bool LaneLedger::IsPausing(const std::string& actor) const {
  return actors_.size() > 1 && clock_->Now() - actors_.at(actor).gave_back <= options_.patience;
}

std::vector<Permit> LaneLedger::GrantTo(const std::string& actor, int capacity) {
  if (IsPausing(actor)) return {};
  int room = std::min(capacity, FairShare()) - PermitsOf(actor);
  std::vector<Permit> granted;
  for (const Claim wanted : {Claim::kOwn, Claim::kSpare, Claim::kLeftLying}) {
    for (int l = 0; l < options_.lanes && room > 0; ++l) {
      Lane& lane = lanes_[l];
      if (lane.permit.has_value() || lane.record.next_fragment >= last_fragment_ || ClaimOn(lane, actor) != wanted)
        continue;
      lane.holder = actor;
      lane.permit = Permit{l, lane.record.next_fragment, policy_version_};
      granted.push_back(*lane.permit);
      --room;
    }
  }
  return granted;
}

LaneLedger::Claim LaneLedger::ClaimOn(const Lane& lane, const std::string& actor) const {
  if (lane.holder == actor) return Claim::kOwn;
  const int share = FairShare();
  const bool spare = lane.holder.empty() || HeldBy(lane.holder) > share;
  if (spare && HeldBy(actor) < share) return Claim::kSpare;
  return clock_->Now() - opened_ > options_.patience ? Claim::kLeftLying : Claim::kNone;
}

int LaneLedger::HeldBy(const std::string& actor) const {
  return static_cast<int>(
      std::count_if(lanes_.begin(), lanes_.end(), [&](const Lane& lane) { return lane.holder == actor; }));
}

int LaneLedger::PermitsOf(const std::string& actor) const {
  return static_cast<int>(std::count_if(
      lanes_.begin(), lanes_.end(), [&](const Lane& lane) { return lane.holder == actor && lane.permit.has_value(); }));
}

int LaneLedger::FairShare() const {
  const int actors = std::max<int>(1, static_cast<int>(actors_.size()));
  return (options_.lanes + actors - 1) / actors;
}

}  // namespace craftfleet
