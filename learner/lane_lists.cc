// LaneScheduler: who holds which lane, and the lists of lanes by what may happen to them next.
#include <algorithm>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "learner/lane_scheduler.h"

namespace craftfleet {
namespace {

// Removes `actor` from the set with this key; empty sets go.
template <typename Actor>
void Erase(int key, Actor* actor, std::map<int, std::set<Actor*>>* sets) {
  const auto entry = sets->find(key);
  if (entry == sets->end()) return;
  entry->second.erase(actor);
  if (entry->second.empty()) sets->erase(entry);
}

}  // namespace

void LaneScheduler::SetHolder(Lane* lane, Actor* actor) {
  if (lane->holder == actor) return;
  if (lane->holder != nullptr) NoteHeld(lane->holder, NumberOf(*lane), false);
  if (actor != nullptr) NoteHeld(actor, NumberOf(*lane), true);
  lane->holder = actor;
}

void LaneScheduler::NoteHeld(Actor* actor, int lane, bool holds) {
  const auto counted = by_held_.find(actor->held());
  if (counted != by_held_.end() && --counted->second == 0) by_held_.erase(counted);
  Erase(actor->held(), actor, &open_by_held_);
  if (holds) {
    actor->lanes.insert(lane);
  } else {
    actor->lanes.erase(lane);
  }
  if (!actor->lanes.empty()) ++by_held_[actor->held()];
  if (!actor->open.empty()) open_by_held_[actor->held()].insert(actor);
}

void LaneScheduler::NoteOpen(Actor* actor, int lane, bool is_open) {
  if (is_open) {
    actor->open.insert(lane);
    open_by_held_[actor->held()].insert(actor);
  } else {
    actor->open.erase(lane);
    if (actor->open.empty()) Erase(actor->held(), actor, &open_by_held_);
  }
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
    if (lane->holder == nullptr) {
      open_and_free_.insert(l);
    } else {
      NoteOpen(lane->holder, l, true);
    }
    lane->listed_holder = lane->holder;
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
  if (list == Lane::List::kOpen) NoteOpen(lane->listed_holder, l, false);
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
