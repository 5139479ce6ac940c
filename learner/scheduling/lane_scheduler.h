// Decides which actor plays which lane, and which fragments count.

#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "common/base/clock.h"
#include "common/base/types.h"
#include "learner/scheduling/assignment.h"
#include "learner/scheduling/lane_table.h"
#include "learner/scheduling/rollout_cutter.h"
#include "learner/scheduling/snapshot_reports.h"
#include "learner/scheduling/worker.h"

namespace craftfleet {

// What an actor asks and sends, handed to the parts that decide: LaneTable is the state, Assignment says who gets the
// next fragment, RolloutCutter which fragments may be played and make a rollout, SnapshotReports which lanes are reset.
// None of them has a lock or waits. WorkerRegistry calls them under its mutex, tells them which actors are active, and
// wakes waiting calls when LaneTable::TakeChange says so.
//
// A permit lapses when its actor has sent no request for its lease, or for twice as long if no other actor sends
// requests; the actor is then removed. A fragment is accepted at most once. Not thread-safe.
class LaneScheduler {
 public:
  struct Options {
    int lanes = 16;                              // 1..
    absl::Duration lease = absl::Seconds(5);     // that actors have at least (Worker::lease)
    absl::Duration comeback = absl::Seconds(2);  // lease left to an actor whose connection broke; at most `lease`
    int resets = 0;                              // lanes reset while loading
    int max_staleness = 0;                       // RolloutCutter::Options
    int64_t rollout_fragments = 1;               // RolloutCutter::Options
  };
  enum class Verdict { kAccepted, kDuplicate, kExpired, kStale };

  // `lanes`: as many as `options` say. `clock` outlives the scheduler.
  LaneScheduler(const Options& options, std::vector<LaneRecord> lanes, Clock* clock);
  LaneScheduler(const LaneScheduler&) = delete;  // its parts refer to each other
  LaneScheduler& operator=(const LaneScheduler&) = delete;

  LaneTable& table() { return table_; }
  const LaneTable& table() const { return table_; }
  Assignment& assignment() { return assignment_; }
  const Assignment& assignment() const { return assignment_; }
  RolloutCutter& rollouts() { return rollouts_; }
  SnapshotReports& reports() { return reports_; }

  // Removes `actor` and frees its permits; ignored if unknown.
  void Remove(absl::string_view actor);
  // Removes actors whose lease has expired; returns their names.
  std::vector<std::string> RemoveExpired();
  // `actor` is being drained, which releases the lanes that it holds without a permit, or no longer so.
  void NoteDrain(absl::string_view actor);

  // Updates `actor`, which is known: it can play `capacity` lanes at once and reports the permits `active`. Frees its
  // other permits. Returns those of `active` that it has lost.
  std::vector<Permit> Renew(absl::string_view actor, absl::Span<const Permit> active, int capacity);
  // Grants new permits to `actor`, which is known, up to its capacity.
  std::vector<Permit> Grant(absl::string_view actor);

  // What Accept would say of a fragment of `actor`, before its content is known: kDuplicate for one that was accepted.
  //   InvalidArgument: the version of the weights is not the permit's.
  absl::StatusOr<Verdict> Judge(absl::string_view actor, const Permit& fragment) const;
  // Decides on a fragment and, if it is accepted, advances its lane by one fragment and copies `snapshot`.
  // `digest` is that of its content (FragmentDigest): a duplicate that differs from the accepted one is logged as an
  // error and counted.   Errors as Judge.
  absl::StatusOr<Verdict> Accept(absl::string_view actor, const Permit& fragment, const LaneSnapshot& snapshot,
                                 uint64_t digest = 0);

 private:
  // Notes that a fragment of the lane, which `sender` has played, is open.
  void NoteOpened(const LaneState& lane, const LaneActor& sender);

  Clock* const clock_;
  LaneTable table_;
  Assignment assignment_;
  RolloutCutter rollouts_;
  SnapshotReports reports_;
};

}  // namespace craftfleet
