#include "deploy/cli/inspect/run_state.h"

#include "common/base/status_macros.h"
#include "learner/run/checkpoint.h"
#include "learner/run/checkpoint_store.h"

namespace craftfleet {

absl::StatusOr<RunState> ReadRunState(const std::string& folder, int64_t steps) {
  const absl::StatusOr<std::string> checkpoint = FindCheckpoint(folder);
  if (!checkpoint.ok()) return RunState{};
  CRAFTFLEET_ASSIGN_OR_RETURN(const v1::CheckpointState state, LoadCheckpointState(*checkpoint));
  RunState run;
  run.begun = true;
  run.steps = state.env_steps();
  const bool evaluated =
      state.config().eval().final_episodes() == 0 || state.final_evaluation_steps() == state.env_steps();
  run.finished = run.steps >= steps && evaluated && state.pending_size() == 0;
  return run;
}

}  // namespace craftfleet
