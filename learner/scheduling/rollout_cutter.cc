#include "learner/scheduling/rollout_cutter.h"

#include <algorithm>
#include <limits>
#include <utility>

#include <absl/strings/str_format.h>

namespace craftfleet {
namespace {

// Forgets the fragments of the iterations before the current one.
void ForgetAccepted(LaneState* lane) {
  while (!lane->accepted.empty() && lane->accepted.front().fragment < lane->start.next_fragment) {
    lane->accepted.pop_front();
  }
}

}  // namespace

void RolloutCutter::OpenIteration(int64_t last_fragment, int64_t policy_version) {
  policy_version_ = policy_version;
  BeginPermits();
  for (LaneState& lane : table_->lanes()) {
    lane.last_fragment = last_fragment;
    ForgetAccepted(&lane);
    lane.earlier_start = std::move(lane.start);
    lane.start = lane.record;
  }
}

void RolloutCutter::PublishVersion(int64_t policy_version) {
  policy_version_ = policy_version;
  next_update_ = policy_version;
  BeginPermits();
  for (LaneState& lane : table_->lanes()) lane.last_fragment = std::numeric_limits<int64_t>::max();
}

std::optional<std::vector<Arrival>> RolloutCutter::TakeRollout() {
  const auto size = static_cast<size_t>(options_.rollout_fragments);
  if (waiting_.size() < size) return std::nullopt;
  for (LaneState& lane : table_->lanes()) {
    ForgetAccepted(&lane);
    lane.earlier_start = lane.start;
  }
  std::vector<Arrival> taken;
  for (size_t i = 0; i < size; ++i) {
    WaitingArrival& waiting = waiting_[i];
    const Permit& fragment = waiting.arrival.permit;
    LaneRecord& start = table_->lanes()[fragment.lane].start;
    start = {fragment.fragment + 1, std::move(waiting.snapshot), std::move(start.snapshot), std::move(waiting.sender)};
    taken.push_back(waiting.arrival);
  }
  waiting_.erase(waiting_.begin(), waiting_.begin() + static_cast<int64_t>(size));
  ++next_update_;
  return taken;
}

void RolloutCutter::BeginPermits() {
  for (LaneState& lane : table_->lanes()) {
    if (!lane.permit.has_value()) lane.since = clock_->Now();
  }
  table_->NoteChange();
}

int64_t RolloutCutter::Ahead() const {
  if (!is_asynchronous()) return std::numeric_limits<int64_t>::max();
  const int64_t rollouts = policy_version_ + options_.max_staleness + 1 - next_update_;
  return rollouts * options_.rollout_fragments - static_cast<int64_t>(waiting_.size()) - table_->playing();
}

bool RolloutCutter::Take(const Permit& fragment, uint64_t digest, const SharedSnapshot& snapshot,
                         const LaneActor& sender) {
  if (!is_asynchronous()) return true;
  const int64_t staleness = StalenessOf(fragment.policy_version);
  if (staleness <= options_.max_staleness) {
    waiting_.push_back({{fragment, digest}, snapshot, sender.worker->name});
    return true;
  }
  ++table_->counters.dropped;
  drops_.Warn(sender.worker->client.Name(),
              absl::StrFormat("fragment %d of lane %d from actor %s is dropped and played again: its weights are %d "
                              "updates old, max_staleness is %d (dropped so far, of all actors: %d)",
                              fragment.fragment, fragment.lane, sender.worker->name, staleness, options_.max_staleness,
                              table_->counters.dropped));
  return false;
}

int64_t RolloutCutter::StalenessOf(int64_t policy_version) const {
  return next_update_ + static_cast<int64_t>(waiting_.size()) / options_.rollout_fragments - policy_version;
}

void RolloutCutter::RewindLane(LaneState* lane) {
  table_->Rewind(lane);
  waiting_.erase(std::remove_if(waiting_.begin(), waiting_.end(),
                                [&](const WaitingArrival& w) { return w.arrival.permit.lane == lane->number; }),
                 waiting_.end());
}

void RolloutCutter::RewindIterations(int iterations) {
  for (LaneState& lane : table_->lanes()) {
    lane.last_fragment = 0;
    if (lane.permit.has_value()) table_->EndPermit(&lane);
    if (iterations == 2) lane.start = std::move(lane.earlier_start);
    RewindLane(&lane);
  }
}

}  // namespace craftfleet
