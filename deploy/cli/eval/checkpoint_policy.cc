#include "deploy/cli/eval/checkpoint_policy.h"

#include <utility>

#include "common/agent/torch_setup.h"
#include "common/base/status_macros.h"
#include "common/process/cpu_pin.h"
#include "common/telemetry/log.h"
#include "learner/run/checkpoint.h"
#include "learner/run/checkpoint_store.h"

namespace craftfleet {
namespace {

absl::Status ComputeAsTheRun(v1::RunConfig::Cpu cpu) {
  const absl::Status status = CheckCpu(cpu);
  if (status.ok()) return PinCpu(cpu);
  LogWarning("%s; the policy may act differently here", status.message());
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<CheckpointPolicy> LoadPolicy(const std::string& path) {
  CheckpointPolicy loaded;
  CRAFTFLEET_ASSIGN_OR_RETURN(loaded.folder, FindCheckpoint(path));
  CRAFTFLEET_ASSIGN_OR_RETURN(Checkpoint checkpoint, LoadCheckpoint(loaded.folder, ""));
  const v1::RunConfig& config = checkpoint.state.config();
  CRAFTFLEET_RETURN_IF_ERROR(ComputeAsTheRun(config.cpu()));
  SetUpTorchThread();
  CRAFTFLEET_ASSIGN_OR_RETURN(loaded.spec, MakeAgentSpec(config));
  CRAFTFLEET_ASSIGN_OR_RETURN(loaded.policy, Policy::Create(loaded.spec, checkpoint.weights, config.tile()));
  loaded.state = std::move(checkpoint.state);
  return loaded;
}

}  // namespace craftfleet
