// The learner's epoch: how often a learner has started on a run folder. Permits carry it, so that a fragment asked for
// by an earlier start is told from one of this start; and only the latest start writes.

#ifndef CRAFTFLEET_LEARNER_RUN_EPOCH_H_
#define CRAFTFLEET_LEARNER_RUN_EPOCH_H_

#include <cstdint>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

namespace craftfleet {

// The epoch of the latest start; 0: no learner has started yet.
//   DataLoss: the file does not begin with a number.
absl::StatusOr<int64_t> ReadEpoch(const std::string& logdir);

// Keeps an earlier start from writing where the folder's lock does not (some shared disks lock nothing): the file
// `epoch` names the latest start, and each looks there before it writes. What it does not keep away is a write that
// was under way while the later start began.
// Thread-compatible: one thread at a time.
class EpochFence {
 public:
  // Makes this start the latest, as number `epoch`; durable when it returns.
  //   FailedPrecondition: another learner has taken that number or a later one; names it.
  absl::Status Take(const std::string& logdir, int64_t epoch);

  // OK while no later start has taken over.
  //   Aborted: one has; names it.   Unavailable: the file can't be read.   FailedPrecondition: Take was not called.
  absl::Status Check() const;

  int64_t epoch() const { return epoch_; }  // 0 before Take

 private:
  std::string logdir_;
  std::string text_;  // of the file, as Take wrote it
  int64_t epoch_ = 0;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_EPOCH_H_
