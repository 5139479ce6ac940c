// Flags of the learners that share out the updates of a run.

#pragma once

#include <absl/status/statusor.h>

#include "learner/ranks/rank_options.h"

namespace craftfleet {

// From --rank, --world_size, --master_addr, --master_port and --rank_timeout or, for those not given, the environment
// variables of torchrun (RANK, WORLD_SIZE, MASTER_ADDR, MASTER_PORT), of a Slurm step (SLURM_PROCID,
// SLURM_STEP_NUM_TASKS) and of an indexed Kubernetes job (JOB_COMPLETION_INDEX), in this order. One learner without
// any of them.
//   InvalidArgument: out of range; names the flag or the variable.
absl::StatusOr<RankOptions> RankOptionsFromFlags();

}  // namespace craftfleet
