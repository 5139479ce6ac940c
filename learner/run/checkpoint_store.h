// The checkpoints of one run: written whole or not at all, the newest ones and the best kept.

#ifndef CRAFTFLEET_LEARNER_RUN_CHECKPOINT_STORE_H_
#define CRAFTFLEET_LEARNER_RUN_CHECKPOINT_STORE_H_

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

// "iter-00000010"
std::string CheckpointName(int64_t iteration);

// The folder of the checkpoint that a user means by `path`: a checkpoint, or a run folder, which stands for its newest.
//   NotFound: neither.
absl::StatusOr<std::string> FindCheckpoint(const std::string& path);

// Thread-compatible: one thread at a time. Only one process may write a store (RunFolder locks).
class CheckpointStore {
 public:
  // To read only: nothing is touched, `folder` need not be there.
  static CheckpointStore At(const std::string& folder) { return CheckpointStore(folder, nullptr); }
  // To write: `folder` is created if need be, and cleared of what a killed writer left. `fence` is asked before each
  // change, and outlives the store; null: anyone may write.
  static absl::StatusOr<CheckpointStore> Open(const std::string& folder, const EpochFence* fence = nullptr);

  // Writes `checkpoint` under a temporary name, syncs, renames; then removes old ones beyond the newest
  // `config.checkpoint.keep` and the best, which is the first to have reached the newest one's `best_score`. One of the
  // same iteration is replaced if it is torn or the run was evaluated since, else left as it is.
  //   ResourceExhausted: disk, quota or file size limit full.   Others as EpochFence::Check. On any error of writing, a
  //   failed sync among them, the earlier checkpoints stand as before and no part of this one is left.
  absl::Status Write(const Checkpoint& checkpoint);

  // Names, the highest iteration first.
  absl::StatusOr<std::vector<std::string>> ListNewestFirst() const;

  // Errors as LoadCheckpoint; NotFound: no checkpoint of that name, and lists those there are.
  absl::StatusOr<Checkpoint> Load(const std::string& name, absl::string_view agent) const;

  // The newest. Never falls back by itself: if the newest can't be had, the error names the newest older one that can.
  //   NotFound: there is none.
  absl::StatusOr<Checkpoint> LoadLatest(absl::string_view agent) const;

  // Removes those of later iterations: a run that is resumed from an older checkpoint leaves them behind.
  absl::Status DiscardNewerThan(int64_t iteration);

 private:
  CheckpointStore(std::string folder, const EpochFence* fence) : folder_(std::move(folder)), fence_(fence) {}
  absl::Status CheckFence() const { return fence_ != nullptr ? fence_->Check() : absl::OkStatus(); }
  std::string PathOf(absl::string_view name) const;
  // Where a checkpoint lies while it or the one in its place is made: a name of this start alone.
  std::string TemporaryPath(absl::string_view name) const;
  // Puts `temporary` in the place of `name`. On failure all is as before.
  absl::Status MoveIn(const std::string& temporary, const std::string& name);
  absl::Status Remove(const std::string& name);
  absl::Status Prune(size_t keep);
  // "" if there is none.
  std::string BestOf(const std::vector<std::string>& newest_first) const;

  std::string folder_;
  const EpochFence* fence_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_CHECKPOINT_STORE_H_
