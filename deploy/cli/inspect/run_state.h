// The progress of the run in a folder.

#ifndef CRAFTFLEET_DEPLOY_CLI_INSPECT_RUN_STATE_H_
#define CRAFTFLEET_DEPLOY_CLI_INSPECT_RUN_STATE_H_

#include <cstdint>
#include <string>

#include <absl/status/statusor.h>

namespace craftfleet {

struct RunState {
  bool begun = false;     // has a checkpoint to resume from
  int64_t steps = 0;      // environment steps of the newest one
  bool finished = false;  // has reached its number of steps, and its final evaluation is complete
};

// `steps`: environment steps that the run is to reach. A run without a folder has not begun.
// Errors as LoadCheckpointState: the newest checkpoint is damaged.
absl::StatusOr<RunState> ReadRunState(const std::string& folder, int64_t steps);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_INSPECT_RUN_STATE_H_
