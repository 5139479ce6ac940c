// A checkpoint: a folder with all that a run needs to go on as if never stopped.
//   weights.safetensors, optimizer.safetensors   tensors; bytes here
//   evaluation-1.safetensors, ...                weights of evaluations that are not over
//   state.pb                                     CheckpointState
//   MANIFEST                                     text: format, program version, then name, size and CRC-32C of each
//   file

#ifndef CRAFTFLEET_LEARNER_RUN_CHECKPOINT_H_
#define CRAFTFLEET_LEARNER_RUN_CHECKPOINT_H_

#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "craftfleet/v1/checkpoint.pb.h"

namespace craftfleet {

inline constexpr int kCheckpointFormat = 1;

struct Checkpoint {
  v1::CheckpointState state;
  std::string weights;                                                 // safetensors
  std::string optimizer;                                               // safetensors
  std::vector<std::shared_ptr<const std::string>> evaluation_weights;  // of state.pending(), in its order; safetensors
};

// Writes `checkpoint` into `folder`, which is created, and syncs all of it but the folder's own name.
absl::Status WriteCheckpointFiles(const std::string& folder, const Checkpoint& checkpoint);

// Reads and checks state.pb alone. Errors as LoadCheckpoint.
absl::StatusOr<v1::CheckpointState> LoadCheckpointState(const std::string& folder);

// Reads and checks everything. `agent`: the only one that is taken; empty: any.
//   InvalidArgument: not a checkpoint.   DataLoss: torn or senseless; says which file and how.
//   FailedPrecondition: of a newer format, or of another agent.
absl::StatusOr<Checkpoint> LoadCheckpoint(const std::string& folder, absl::string_view agent);

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_CHECKPOINT_H_
