// Loads lanes from checkpoints, also those with invalid snapshots.

#pragma once

#include <vector>

#include "common/wire/fragment_check.h"
#include "craftfleet/v1/checkpoint.pb.h"
#include "learner/scheduling/lane_scheduler.h"

namespace craftfleet {

struct LoadedLanes {
  std::vector<LaneRecord> records;
  int resets = 0;  // number of records that were reset because their state was invalid
};

// Returns the checkpoint's lanes, or new ones if `state` has none. If the snapshot or recurrent state of a lane is
// invalid, the lane is reset to its previous snapshot or to a new game, and an error is logged. The learner has refused
// states of another size before.
LoadedLanes LoadLanes(const v1::CheckpointState& state, const wire::FragmentShape& shape);

// Converts a record to its form in checkpoints.
v1::LaneState ToProto(const LaneRecord& record);

}  // namespace craftfleet
