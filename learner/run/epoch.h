// The learner's epoch: how often a learner has started on a run folder. Permits carry it, so that fragments of an
// earlier start can be recognised, and only the latest start may write. File: FORMATS.md, section 9.

#pragma once

#include <cstdint>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

namespace craftfleet {

// Reads the epoch of the latest start; 0: no learner has started yet.
//   DataLoss: the file does not begin with a number in 1..kMaxCount-1.
absl::StatusOr<int64_t> ReadEpoch(const std::string& logdir);

// Prevents an earlier start from writing where the folder's lock has no effect, as on some shared disks. The file
// `epoch` names the latest start, and each start reads it before it writes. A write in progress when the later start
// began is not prevented.
// Thread-compatible: one thread at a time.
class EpochFence {
 public:
  // Makes this start the latest, with number `epoch`. Durable on return.
  //   FailedPrecondition: another learner has taken this number or a later one; names that learner.
  absl::Status Take(const std::string& logdir, int64_t epoch);

  // Checks that no later start has taken over.
  //   Aborted: one has; names it.   Unavailable: the file can't be read.   FailedPrecondition: Take has not succeeded.
  absl::Status Check() const;

  int64_t epoch() const { return epoch_; }  // 0 before Take

 private:
  std::string logdir_;
  std::string text_;  // the file's content, written by Take
  int64_t epoch_ = 0;
};

}  // namespace craftfleet
