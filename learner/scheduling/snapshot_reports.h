// What happens if a lane's snapshot can't be restored.

#pragma once

#include <cstdint>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "learner/scheduling/assignment.h"
#include "learner/scheduling/lane_table.h"
#include "learner/scheduling/rollout_cutter.h"

namespace craftfleet {

// A reset can change the result, so one lying client (WorkerClient) must not cause it, whatever names its actors have.
// The first report that a snapshot can't be restored only moves the lane to an actor of another client, which either
// plays the fragment, and the report is forgotten, or confirms it. Where nobody of another client can play, another
// actor confirms it; and a single actor confirms its own. A second report also counts if nobody else has answered for
// `kNobodyElse`, so that no lane stays broken.
//
// If the lane has advanced in this iteration, it is reset to the beginning of the iteration, so that the result does
// not change; otherwise to its previous snapshot, or to a new game if it has none. Permit::reload is set in the permit
// for the first fragment after a reset to another game. Not thread-safe.
class SnapshotReports {
 public:
  static constexpr absl::Duration kNobodyElse = absl::Minutes(1);

  // The pointers outlive it.
  SnapshotReports(LaneTable* table, Assignment* assignment, RolloutCutter* rollouts, Clock* clock)
      : table_(table), assignment_(assignment), rollouts_(rollouts), clock_(clock) {}

  // `actor` returns the permit for `fragment` of `lane`, since no environment server can restore the snapshot before
  // it; `reason` is logged. Ignored unless the actor has that permit.
  void Add(absl::string_view actor, int lane, int64_t fragment, absl::string_view reason);

 private:
  bool IsConfirmedBy(const LaneActor& actor, const LaneState::Report& report) const;
  void Reset(absl::string_view reason, LaneState* lane);

  LaneTable* const table_;
  Assignment* const assignment_;
  RolloutCutter* const rollouts_;
  Clock* const clock_;
};

}  // namespace craftfleet
