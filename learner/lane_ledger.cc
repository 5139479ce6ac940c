#include "learner/lane_ledger.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/check.h"
#include "common/log.h"
#include "common/printable.h"

namespace craftfleet {

namespace {

constexpr int kMaxRefusals = 4;  // of one snapshot, whoever they are from

absl::Status NotKnown(absl::string_view actor) {
  return absl::AbortedError(absl::StrFormat("actor %s is not known here: join again", actor));
}

}  // namespace

LaneLedger::LaneLedger(const Options& options, std::vector<LaneRecord> lanes, Clock* clock)
    : options_(options), clock_(clock), resets_(options.resets) {
  CRAFTFLEET_CHECK(static_cast<int>(lanes.size()) == options.lanes);
  for (LaneRecord& record : lanes) {
    Lane& lane = lanes_.emplace_back();
    lane.start = record;
    lane.record = std::move(record);
    lane.since = clock_->Now();
  }
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
                                                         int capacity, absl::Duration wait,
                                                         absl::Span<const int64_t> steps) {
  const std::string name(actor_name);
  MutexLock lock(&mu_);
  auto known = actors_.find(name);
  // Late, but nobody asked for its lanes in the meantime.
  if (known != actors_.end() && clock_->Now() - known->second.last_word <= 2 * options_.lease) {
    known->second.last_word = clock_->Now();
    NoteProgress(&known->second, active, steps);
  }
  ExpireLeases();
  EndStalls();
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
                                                       const LaneSnapshot& snapshot, uint64_t digest) {
  MutexLock lock(&mu_);
  CRAFTFLEET_CHECK(fragment.lane >= 0 && fragment.lane < options_.lanes);
  Lane& lane = lanes_[fragment.lane];
  if (fragment.fragment < lane.record.next_fragment) {
    Compare(actor, fragment, digest);
    return Verdict::kDuplicate;
  }
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
  times_.push_back(clock_->Now() - lane.since);
  EndPermit(&lane);
  SetHolder(&lane, sender->second.draining ? nullptr : &sender->second);
  lane.record = {fragment.fragment + 1, snapshot, std::move(lane.record.snapshot), sender->first};
  lane.taken.push_back({fragment.fragment, digest, sender->first});
  lane.stalls = 0;
  lane.avoided = nullptr;
  lane.refusals = 0;
  EndPause(&sender->second);
  ++sender->second.fragments;
  sender->second.last_word = clock_->Now();
  if (lane.record.next_fragment < last_fragment_) changed_.NotifyAll();
  return Verdict::kAccepted;
}

void LaneLedger::Compare(absl::string_view actor, const Permit& fragment, uint64_t digest) {
  if (actors_.count(std::string(actor)) == 0) return;
  for (Taken& taken : lanes_[fragment.lane].taken) {
    if (taken.fragment != fragment.fragment || taken.digest == digest) continue;
    ++differing_;
    if (taken.differs) continue;
    taken.differs = true;
    LogError(
        "fragment %d of lane %d: actor %s sent %016x, which counts, and actor %s sent %016x; they should be equal: "
        "compare their programs and CPUs",
        fragment.fragment, fragment.lane, taken.sender, taken.digest, actor, digest);
  }
}

bool LaneLedger::Restore(const Permit& fragment, const LaneSnapshot& snapshot, uint64_t digest) {
  MutexLock lock(&mu_);
  CRAFTFLEET_CHECK(fragment.lane >= 0 && fragment.lane < options_.lanes);
  Lane& lane = lanes_[fragment.lane];
  if (lane.record.next_fragment != fragment.fragment || lane.permit.has_value()) return false;
  lane.record = {fragment.fragment + 1, snapshot, std::move(lane.record.snapshot), ""};
  lane.taken.push_back({fragment.fragment, digest, "an earlier start"});
  lane.restored = true;
  return true;
}

bool LaneLedger::Counts(int lane, int64_t fragment, uint64_t digest) const {
  MutexLock lock(&mu_);
  const std::deque<Taken>& taken = lanes_[lane].taken;
  return std::any_of(taken.begin(), taken.end(),
                     [&](const Taken& t) { return t.fragment == fragment && t.digest == digest; });
}

void LaneLedger::Refuse(absl::string_view actor_name, int l, int64_t fragment, absl::string_view reason) {
  MutexLock lock(&mu_);
  const auto actor = actors_.find(std::string(actor_name));
  if (actor == actors_.end() || l < 0 || l >= options_.lanes) return;
  Lane& lane = lanes_[l];
  if (!IsPlayer(lane, &actor->second) || !lane.permit.has_value() || lane.permit->fragment != fragment) return;
  GiveToOthers(&lane, &actor->second);
  if (lane.record.snapshot.game.empty()) return;  // a new game: there is nothing to put it back to
  const bool is_first = lane.refusals++ == 0;
  const bool is_other = !is_first && lane.refuser != actor->first;
  lane.refuser = actor->first;
  LogWarning("actor %s can't go on with lane %d: %s", actor->first, l, Printable(reason));
  const bool is_enough = is_other || (!is_first && !HasOthers(actor->second)) || lane.refusals >= kMaxRefusals;
  if (is_enough && !lane.permit.has_value()) PutBack(&lane, reason);
  changed_.NotifyAll();
}

void LaneLedger::PutBack(Lane* lane, absl::string_view reason) {
  LaneRecord& record = lane->record;
  const std::string sender = record.sender.empty() ? "an earlier start" : absl::StrCat("actor ", record.sender);
  const std::string trouble =
      absl::StrFormat("lane %d: the snapshot after its fragment %d, from %s, is no game (%s)", lane - lanes_.data(),
                      record.next_fragment - 1, sender, Printable(reason));
  if (record.next_fragment > lane->start.next_fragment) {
    LogError("%s; it is played again from fragment %d on", trouble, lane->start.next_fragment);
    Rewind(lane);
  } else {
    LogError("%s; it goes on %s", trouble,
             record.previous.game.empty() ? "with a new game" : "from the snapshot before that fragment");
    const size_t state_size = record.snapshot.state.size();
    record.snapshot = std::move(record.previous);
    record.snapshot.state.resize(state_size);
    record.previous = {};
    record.sender.clear();
    lane->start = record;
  }
  ++resets_;
  lane->refusals = 0;
  lane->avoided = nullptr;
}

void LaneLedger::Rewind(Lane* lane) {
  lane->record = lane->start;
  while (!lane->taken.empty() && lane->taken.back().fragment >= lane->start.next_fragment) lane->taken.pop_back();
  lane->refusals = 0;
}

void LaneLedger::RewindIteration() {
  MutexLock lock(&mu_);
  last_fragment_ = 0;
  for (Lane& lane : lanes_) {
    if (lane.permit.has_value()) EndPermit(&lane);
    Rewind(&lane);
  }
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
  times_.clear();
  for (Lane& lane : lanes_) {
    lane.since = clock_->Now();
    if (std::exchange(lane.restored, false)) continue;
    while (!lane.taken.empty() && lane.taken.front().fragment < lane.start.next_fragment) lane.taken.pop_front();
    lane.start = lane.record;
  }
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
    infos.push_back({name, actor.address, actor.permits, actor.fragments, clock_->Now() - actor.last_word,
                     actor.draining, actor.pause > absl::ZeroDuration()});
  }
  return infos;
}

int64_t LaneLedger::lapsed() const {
  MutexLock lock(&mu_);
  return lapsed_;
}

int64_t LaneLedger::resets() const {
  MutexLock lock(&mu_);
  return resets_;
}

int64_t LaneLedger::differing() const {
  MutexLock lock(&mu_);
  return differing_;
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
    if (lane.avoided == &actor->second) lane.avoided = nullptr;
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
  if (lane->holder == actor) {
    SetHolder(lane, lane->backup);
    lane->pace = lane->backup_pace;
  }
  lane->backup = nullptr;
}

}  // namespace craftfleet
