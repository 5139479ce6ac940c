// The checkpoints of one run. Each is written completely or not at all; the newest ones and the best are kept.

#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "learner/run/checkpoint.h"
#include "learner/run/epoch.h"

namespace craftfleet {

// The folder name of a checkpoint, such as "iter-00000010".
std::string CheckpointName(int64_t iteration);
// The inverse; -1: `name` is not a checkpoint's.
int64_t IterationOf(absl::string_view name);

// Resolves a user's `path` to a checkpoint's folder. `path` is a checkpoint, or a run folder, for its newest
// checkpoint.
//   NotFound: it is neither.   Others as ListNewestFirst, of a run folder.
absl::StatusOr<std::string> FindCheckpoint(const std::string& path);

// Loads FindCheckpoint(path) and stores its folder in `folder`. If a run's newest checkpoint can't be loaded, the error
// names the newest older one that can.
//   Errors as FindCheckpoint and LoadCheckpoint.
absl::StatusOr<Checkpoint> LoadFound(const std::string& path, std::string* folder);

// Thread-compatible: one thread at a time. Only one process may write a store (RunFolder locks).
class CheckpointStore {
 public:
  // A read-only store: nothing is changed. `folder` need not exist.
  static CheckpointStore At(const std::string& folder) { return CheckpointStore(folder, nullptr); }
  // A writable store: creates `folder` if necessary and removes leftovers of a killed writer. `fence` is checked before
  // each change and outlives the store; null: no check.
  static absl::StatusOr<CheckpointStore> Open(const std::string& folder, const EpochFence* fence = nullptr);

  // Writes `checkpoint` under a temporary name, syncs and renames it. Then removes all but the newest
  // `config.checkpoint.keep` and the best, which is the first with the newest one's `best_score`. An existing
  // checkpoint of the same iteration is replaced if it can't be loaded or the run was evaluated since, else unchanged.
  //   ResourceExhausted: disk, quota or file size limit reached.   Others as EpochFence::Check. After any error but
  //   Aborted, including a failed sync, the earlier checkpoints are unchanged and no part of this one is left.
  absl::Status Write(const Checkpoint& checkpoint);

  // Names, the highest iteration first; none if there is no folder.
  //   Unavailable: the folder is a link that leads nowhere.   Others as ListFolder: it cannot be listed.
  absl::StatusOr<std::vector<std::string>> ListNewestFirst() const;

  // Errors as LoadCheckpoint. NotFound: no checkpoint of that name; lists the existing ones.   DataLoss also: its name
  // is that of another iteration, which is named.
  absl::StatusOr<Checkpoint> Load(const std::string& name) const;

  // Loads the newest checkpoint. There is no fallback: if it can't be loaded, the error names the newest older one that
  // can.
  //   NotFound: there is no checkpoint.
  absl::StatusOr<Checkpoint> LoadLatest() const;

  // Removes checkpoints of later iterations, when a run is resumed from an older checkpoint.
  absl::Status DiscardNewerThan(int64_t iteration);

 private:
  CheckpointStore(std::string folder, const EpochFence* fence) : folder_(std::move(folder)), fence_(fence) {}
  absl::Status CheckFence() const { return fence_ != nullptr ? fence_->Check() : absl::OkStatus(); }
  std::string PathOf(absl::string_view name) const;
  // The temporary path of a checkpoint while it is written or replaced. Unique to this start of the learner.
  std::string TemporaryPath(absl::string_view name) const;
  // Renames `temporary` to `name`, replacing an existing one. On an error nothing changes.
  absl::Status MoveIn(const std::string& temporary, const std::string& name);
  absl::Status Remove(const std::string& name);
  absl::Status Prune(size_t keep);
  // The name of the best checkpoint; "" if there is none.
  std::string BestOf(const std::vector<std::string>& newest_first) const;

  std::string folder_;
  const EpochFence* fence_;
};

}  // namespace craftfleet
