#include "learner/scheduling/snapshot_reports.h"

#include <string>
#include <utility>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/printable.h"
#include "common/telemetry/log.h"

namespace craftfleet {

void SnapshotReports::Add(absl::string_view actor_name, int l, int64_t fragment, absl::string_view reason) {
  LaneActor* const actor = table_->Find(actor_name);
  if (actor == nullptr || l < 0 || l >= table_->size()) return;
  LaneState& lane = table_->lanes()[l];
  if (!lane.IsPlayedBy(*actor) || lane.permit->fragment != fragment) return;
  assignment_->GiveToOthers(actor, &lane);
  table_->NoteChange();
  if (lane.record.snapshot->game.empty()) return;  // a new game cannot be reset
  const bool is_first = !lane.report.has_value();
  const bool is_confirmed = !is_first && IsConfirmedBy(*actor, *lane.report);
  if (is_first) lane.report = LaneState::Report{actor->worker->client.Name(), actor->worker->name, clock_->Now()};
  // Others are not logged: an actor may repeat its report for ever.
  if (is_first || is_confirmed) LogWarning("actor %s can't restore lane %d: %s", actor_name, l, Printable(reason));
  if (is_confirmed && !lane.permit.has_value()) Reset(reason, &lane);
}

bool SnapshotReports::IsConfirmedBy(const LaneActor& actor, const LaneState::Report& report) const {
  if (clock_->Now() - report.time >= kNobodyElse || actor.worker->client.Name() != report.client) return true;
  if (assignment_->HasOtherClients(actor)) return false;
  return actor.worker->name != report.actor || !assignment_->HasOthers(actor);
}

void SnapshotReports::Reset(absl::string_view reason, LaneState* lane) {
  LaneRecord& record = lane->record;
  const std::string sender = record.sender.empty() ? "an earlier start" : absl::StrCat("actor ", record.sender);
  const std::string error = absl::StrFormat("lane %d: the snapshot after its fragment %d, from %s, is not a game (%s)",
                                            lane->number, record.next_fragment - 1, sender, Printable(reason));
  if (record.next_fragment > lane->start.next_fragment) {
    LogError("%s; it is played again from fragment %d on", error, lane->start.next_fragment);
    rollouts_->RewindLane(lane);
  } else {
    LogError("%s; it resumes %s", error,
             record.previous->game.empty() ? "with a new game" : "from the snapshot before that fragment");
    LaneSnapshot previous = *record.previous;
    previous.state.resize(record.snapshot->state.size());
    record.snapshot = std::move(previous);
    record.previous = {};
    record.sender.clear();
    lane->start = record;
    lane->reset_at = record.next_fragment;  // its number does not change
  }
  ++table_->counters.resets;
  lane->report.reset();
  lane->avoided.clear();
}

}  // namespace craftfleet
