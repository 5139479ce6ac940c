// How far the run in a folder is.

#ifndef CRAFTFLEET_DEPLOY_EXPERIMENT_RUN_STATE_H_
#define CRAFTFLEET_DEPLOY_EXPERIMENT_RUN_STATE_H_

#include <cstdint>
#include <string>

#include <absl/status/statusor.h>

namespace craftfleet {

struct RunState {
  bool begun = false;     // has a checkpoint to go on from
  int64_t steps = 0;      // environment steps of the newest one
  bool finished = false;  // it has reached the steps asked for, and its last evaluation is over
};

// `steps`: environment steps that the run is to reach. A folder that is not there has not begun.
// Errors as LoadCheckpointState: the newest checkpoint is torn.
absl::StatusOr<RunState> ReadRunState(const std::string& folder, int64_t steps);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_EXPERIMENT_RUN_STATE_H_
