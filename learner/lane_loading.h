// Lanes out of checkpoints, which may be old or hold what no game can be restored from.

#ifndef CRAFTFLEET_LEARNER_LANE_LOADING_H_
#define CRAFTFLEET_LEARNER_LANE_LOADING_H_

#include <vector>

#include "common/wire/fragment_check.h"
#include "craftfleet/v1/checkpoint.pb.h"
#include "learner/lane_ledger.h"

namespace craftfleet {

struct LoadedLanes {
  std::vector<LaneRecord> records;
  int resets = 0;  // of these, how many were put back
};

// Lanes as the checkpoint has them, new ones without one. Snapshots of version 0.1 are put into envelopes. A lane whose
// snapshot or recurrent state can't be goes on from its previous one or with a new game, which is said in the log.
LoadedLanes LoadLanes(const v1::CheckpointState& state, const wire::FragmentShape& shape);

// As a checkpoint keeps it.
v1::LaneState ToProto(const LaneRecord& record);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_LANE_LOADING_H_
