// Measures on this machine what a step of a run costs.

#ifndef CRAFTFLEET_DEPLOY_CLI_PLAN_MEASURE_H_
#define CRAFTFLEET_DEPLOY_CLI_PLAN_MEASURE_H_

#include <string>

#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/base/types.h"
#include "craftfleet/v1/config.pb.h"
#include "deploy/cli/plan/costs.h"

namespace craftfleet {

// Takes about `duration`; with large agents longer, since each part is done at least once. `config` is complete
// (CompleteConfig); its distillation and corrections for older weights are left out. `device`, as FindDevice returns
// it: also measures updates there unless it is "cpu". All are CPU times, so other work on the machine hardly changes
// them, but gpu_update_us is elapsed time.
//   InvalidArgument: the environment or the agent does not exist.   Others as PpoUpdater, Policy, EnvClient and
//   wire::Server.
absl::StatusOr<Costs> MeasureCosts(const v1::RunConfig& config, const std::string& device, absl::Duration duration);

// A part of that: games are played with random actions, on an environment server over TCP.
absl::StatusOr<FrameCosts> MeasureGames(const v1::RunConfig& config, FrameFormat format, absl::Duration duration);

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_PLAN_MEASURE_H_
