// The policy of a checkpoint, for programs that play with it.

#pragma once

#include <memory>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/agent/agent_spec.h"
#include "common/agent/policy.h"
#include "craftfleet/v1/checkpoint.pb.h"

namespace craftfleet {

struct CheckpointPolicy {
  std::string folder;  // of the checkpoint
  v1::CheckpointState state;
  AgentSpec spec;
  std::shared_ptr<const Policy> policy;
};

// Loads the checkpoint `path`, the newest one of the run folder `path`, or the weights in a folder of results
// (deploy/experiments/collect.py --weights). The first call sets up LibTorch, with the run's instruction set if this
// CPU supports it, so that episodes are the same as in the run's own evaluations. For that the process may execute
// itself again (PinCpu): call it before work that would be lost.
//   Errors as FindCheckpoint, LoadCheckpoint, ResolveRunConfig and Policy::Create.
absl::StatusOr<CheckpointPolicy> LoadPolicy(const std::string& path);

// Whether textures with this digest (common/io/texture_digest.h) are those of the checkpoint's run.
//   FailedPrecondition: they differ, so that the agent sees other pictures.
absl::Status CheckTextures(const v1::CheckpointState& state, absl::string_view digest);

}  // namespace craftfleet
