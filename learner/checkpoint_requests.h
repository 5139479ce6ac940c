// Checkpoints that are asked for while a run goes on.

#ifndef CRAFTFLEET_LEARNER_CHECKPOINT_REQUESTS_H_
#define CRAFTFLEET_LEARNER_CHECKPOINT_REQUESTS_H_

#include <cstdint>

#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/mutex.h"

namespace craftfleet {

// Whoever asks waits until the trainer, between two updates, has written one. Thread-safe.
class CheckpointRequests {
 public:
  // The iteration of the checkpoint.
  //   DeadlineExceeded: not written within `timeout`.   Unavailable: Close was called.   Others: it can't be written.
  absl::StatusOr<int64_t> Ask(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);

  // The trainer's side: whether anybody waits, and what all of them are told.
  bool pending() const ABSL_LOCKS_EXCLUDED(mu_);
  void Answer(const absl::StatusOr<int64_t>& iteration) ABSL_LOCKS_EXCLUDED(mu_);
  // Nothing will be written any more. Idempotent.
  void Close() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  mutable Mutex mu_;
  CondVar changed_;
  bool asked_ ABSL_GUARDED_BY(mu_) = false;
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
  int64_t answers_ ABSL_GUARDED_BY(mu_) = 0;
  absl::StatusOr<int64_t> answer_ ABSL_GUARDED_BY(mu_) = 0;  // the last one
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_CHECKPOINT_REQUESTS_H_
