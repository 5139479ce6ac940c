// LaneScheduler: who holds which lane, and the lists of lanes by what may happen to them next.
#include <algorithm>
#include <utility>
#include <vector>

#include "learner/lane_scheduler.h"

namespace craftfleet {

void LaneScheduler::SetHolder(Lane* lane, Actor* actor) {
  const int l = NumberOf(*lane);
  const auto count = [this, l](Actor* holder, bool holds) {
    const auto before = by_held_.find(holder->held());
    if (before != by_held_.end()) {
      before->second.erase(holder);
      if (before->second.empty()) by_held_.erase(before);
    }
    if (holds) {
      holder->lanes.insert(l);
    } else {
      holder->lanes.erase(l);
    }
    if (!holder->lanes.empty()) by_held_[holder->held()].insert(holder);
  };
  if (lane->holder == actor) return;
  if (lane->holder != nullptr) count(lane->holder, false);
  if (actor != nullptr) count(actor, true);
  lane->holder = actor;
}

void LaneScheduler::EndPermit(Lane* lane) {
  const int l = NumberOf(*lane);
  lane->holder->permits.erase(l);
  if (lane->backup != nullptr) lane->backup->permits.erase(l);
  lane->backup = nullptr;
  lane->permit.reset();
  lane->since = clock_->Now();
  --playing_;
  List(lane);
}

void LaneScheduler::Revoke(Lane* lane, Actor* actor) {
  if (!IsPlayer(*lane, actor)) return;
  if (lane->report.has_value() && IsIndependent(*lane->report, *actor)) ++lane->report->unanswered;
  if (lane->backup == nullptr) {
    EndPermit(lane);
    SetHolder(lane, nullptr);
    lane->since = absl::InfinitePast();  // free for any actor at once
  } else {
    actor->permits.erase(NumberOf(*lane));
    if (lane->holder == actor) {
      SetHolder(lane, lane->backup);
      lane->pace = lane->backup_pace;
    }
    lane->backup = nullptr;
  }
  List(lane);
}

void LaneScheduler::List(Lane* lane) {
  Unlist(lane);
  const int l = NumberOf(*lane);
  lane->listed_since = lane->since;
  if (lane->IsOpen()) {
    lane->list = lane->holder == nullptr ? Lane::List::kOpenAndFree : Lane::List::kOpen;
    open_.emplace(lane->since, l);
    if (lane->holder == nullptr) open_and_free_.insert(l);
  } else if (lane->permit.has_value() && lane->backup == nullptr) {
    lane->list = Lane::List::kWithoutBackup;
    without_backup_.emplace(lane->since, l);
  }
}

void LaneScheduler::Unlist(Lane* lane) {
  const int l = NumberOf(*lane);
  const Lane::List list = std::exchange(lane->list, Lane::List::kNone);
  if (list == Lane::List::kWithoutBackup) without_backup_.erase({lane->listed_since, l});
  if (list == Lane::List::kOpen || list == Lane::List::kOpenAndFree) open_.erase({lane->listed_since, l});
  if (list == Lane::List::kOpenAndFree) open_and_free_.erase(l);
}

void LaneScheduler::ListAll() {
  for (Lane& lane : lanes_) List(&lane);
}

std::vector<int> LaneScheduler::OlderThan(const std::set<std::pair<absl::Time, int>>& list, absl::Duration age,
                                          absl::Time now) {
  std::vector<int> lanes;
  for (auto entry = list.begin(); entry != list.end() && now - entry->first > age; ++entry) {
    lanes.push_back(entry->second);
  }
  std::sort(lanes.begin(), lanes.end());
  return lanes;
}

}  // namespace craftfleet
