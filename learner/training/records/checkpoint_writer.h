// Writes a run's checkpoints when they are due, and retries failed ones.

#pragma once

#include <cstdint>
#include <functional>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "learner/run/checkpoint.h"
#include "learner/run/run_folder.h"
#include "learner/training/records/checkpoint_requests.h"
#include "learner/training/records/disk_wait.h"

namespace craftfleet {

// Writes periodic, requested and final checkpoints. Used by the training thread; age() is
// thread-safe.
class CheckpointWriter {
 public:
  struct Parts {
    RunFolder* folder;  // all pointers outlive the writer
    CheckpointRequests* requests;
    DiskWait* disk;
    Clock* clock;
    // Returns the run's state after its last finished iteration, or why it can't be had.
    std::function<absl::StatusOr<Checkpoint>()> make;
  };

  // `every_iterations`: the period of checkpoints, 1 or more.
  CheckpointWriter(int every_iterations, Parts parts);

  // Writes a checkpoint now. Errors as Parts::make and RunFolder::WriteCheckpoint.
  absl::Status Write();
  // The same, unless this start has already written one of `iteration`, and nothing has changed since (NoteChange).
  absl::Status WriteUnlessWritten(int64_t iteration);

  // To be called after each `iteration` but the last: writes a checkpoint if one is due, or if the last one due could
  // not be written. Write errors are logged, and training continues.
  //   Aborted: another learner has taken over the run folder.
  absl::Status OnIteration(int64_t iteration);

  // Answers pending requests with a checkpoint of `iteration`, the last finished one.
  void ServeRequests(int64_t iteration);

  // The run's state has changed without a further iteration: WriteUnlessWritten and WriteLast write again.
  void NoteChange() { written_ = -1; }

  // To be called after the last `iteration`: as WriteUnlessWritten, but retries while the disk is full or may not be
  // written, until training is asked to stop.
  absl::Status WriteLast(int64_t iteration);

  // Time since the last checkpoint, or since construction.
  absl::Duration age() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  const int every_iterations_;
  const Parts parts_;
  int64_t written_ = -1;  // iteration of the last checkpoint; -1: none since the start or NoteChange
  bool missed_ = false;   // the last checkpoint due could not be written
  mutable Mutex mu_;
  absl::Time time_ ABSL_GUARDED_BY(mu_);  // of the last checkpoint
};

}  // namespace craftfleet
