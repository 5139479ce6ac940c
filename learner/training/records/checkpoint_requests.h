// Requests for a checkpoint while a run trains.

#pragma once

#include <cstdint>

#include <absl/status/statusor.h>
#include <absl/time/time.h>

#include "common/base/mutex.h"

namespace craftfleet {

// Callers wait until the trainer has written a checkpoint, between two updates. Thread-safe.
class CheckpointRequests {
 public:
  // Requests a checkpoint and waits for it; returns its iteration.
  //   DeadlineExceeded: not written within `timeout`.   Unavailable: training has ended.   Others: it can't be written.
  absl::StatusOr<int64_t> Ask(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);

  // For the trainer: whether a request is pending.
  bool pending() const ABSL_LOCKS_EXCLUDED(mu_);
  // For the trainer: answers all pending requests with the iteration written, or the error.
  void Answer(const absl::StatusOr<int64_t>& iteration) ABSL_LOCKS_EXCLUDED(mu_);
  // For the trainer: training has ended. Ends pending and later requests with Unavailable. Idempotent.
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
