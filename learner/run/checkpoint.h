// A checkpoint: a folder with everything that a run needs to continue as if it had never stopped. Files and fields:
// FORMATS.md, section 7.

#pragma once

#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/checkpoint.pb.h"

namespace craftfleet {

inline constexpr int kCheckpointFormat = 2;

struct Checkpoint {
  v1::CheckpointState state;
  std::shared_ptr<const std::string> weights;                          // safetensors
  std::string optimizer;                                               // safetensors
  std::shared_ptr<const std::string> play_weights;                     // of state.play(), if it has one; safetensors
  std::vector<std::shared_ptr<const std::string>> evaluation_weights;  // of each of state.pending(); safetensors
};

// InvalidArgument with the field, its value and its range (checkpoint.proto) if a value is one that no run can have.
// Snapshots and states of lanes are not checked: the learner refuses states of another size than the agent's, and
// LoadLanes resets a lane whose snapshot or state is invalid.
absl::Status CheckCheckpointState(const v1::CheckpointState& state);

// Creates `folder`, writes `checkpoint` into it and syncs it, except for the folder's entry in its parent.
absl::Status WriteCheckpointFiles(const std::string& folder, const Checkpoint& checkpoint);

// Reads and checks state.pb alone. Errors as LoadCheckpoint.
absl::StatusOr<v1::CheckpointState> LoadCheckpointState(const std::string& folder);

// Reads and checks the whole checkpoint.
//   InvalidArgument: not a checkpoint.   DataLoss: torn or inconsistent; names the file and the error.
//   FailedPrecondition: of another format.
absl::StatusOr<Checkpoint> LoadCheckpoint(const std::string& folder);

}  // namespace craftfleet
