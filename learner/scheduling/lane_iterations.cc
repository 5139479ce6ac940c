// LaneScheduler: where iterations begin and end, and how far play runs ahead of them.
#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "learner/scheduling/lane_scheduler.h"

namespace craftfleet {

void LaneScheduler::OpenIteration(int64_t last_fragment, int64_t policy_version) {
  policy_version_ = policy_version;
  BeginPermits();
  for (Lane& lane : lanes_) {
    BeginLane(&lane);
    lane.last_fragment = last_fragment;
  }
}

void LaneScheduler::PublishVersion(int64_t policy_version) {
  policy_version_ = policy_version;
  next_update_ = policy_version;
  BeginPermits();
  for (Lane& lane : lanes_) lane.last_fragment = std::numeric_limits<int64_t>::max();
}

std::optional<std::vector<Arrival>> LaneScheduler::TakeRollout() {
  const auto size = static_cast<size_t>(options_.rollout_fragments);
  if (waiting_.size() < size) return std::nullopt;
  for (Lane& lane : lanes_) {
    while (!lane.accepted.empty() && lane.accepted.front().fragment < lane.start.next_fragment)
      lane.accepted.pop_front();
    lane.earlier_start = lane.start;
  }
  std::vector<Arrival> taken;
  for (size_t i = 0; i < size; ++i) {
    WaitingArrival& waiting = waiting_[i];
    const Permit& fragment = waiting.arrival.permit;
    LaneRecord& start = lanes_[fragment.lane].start;
    start = {fragment.fragment + 1, std::move(waiting.snapshot), std::move(start.snapshot), std::move(waiting.sender)};
    taken.push_back(waiting.arrival);
  }
  waiting_.erase(waiting_.begin(), waiting_.begin() + static_cast<int64_t>(size));
  ++next_update_;
  return taken;
}

void LaneScheduler::BeginPermits() {
  for (Lane& lane : lanes_) {
    if (!lane.permit.has_value()) lane.since = clock_->Now();
  }
  change_.all = true;
}

void LaneScheduler::BeginLane(Lane* lane) {
  if (std::exchange(lane->restored, false)) return;
  while (!lane->accepted.empty() && lane->accepted.front().fragment < lane->start.next_fragment)
    lane->accepted.pop_front();
  lane->earlier_start = std::move(lane->start);
  lane->start = lane->record;
}

int64_t LaneScheduler::Ahead() const {
  if (options_.max_staleness == 0) return std::numeric_limits<int64_t>::max();
  const int64_t rollouts = policy_version_ + options_.max_staleness + 1 - next_update_;
  return rollouts * options_.rollout_fragments - static_cast<int64_t>(waiting_.size()) - playing_;
}

int64_t LaneScheduler::StalenessOf(int64_t policy_version) const {
  return next_update_ + static_cast<int64_t>(waiting_.size()) / options_.rollout_fragments - policy_version;
}

void LaneScheduler::Rewind(Lane* lane) {
  lane->record = lane->start;
  while (!lane->accepted.empty() && lane->accepted.back().fragment >= lane->start.next_fragment)
    lane->accepted.pop_back();
  lane->report.reset();
  const int number = NumberOf(*lane);
  waiting_.erase(std::remove_if(waiting_.begin(), waiting_.end(),
                                [&](const WaitingArrival& w) { return w.arrival.permit.lane == number; }),
                 waiting_.end());
}

void LaneScheduler::RewindIterations(int iterations) {
  for (Lane& lane : lanes_) {
    lane.last_fragment = 0;
    if (lane.permit.has_value()) EndPermit(&lane);
    if (iterations == 2) lane.start = std::move(lane.earlier_start);
    Rewind(&lane);
  }
}

}  // namespace craftfleet
