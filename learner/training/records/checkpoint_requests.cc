#include "learner/training/records/checkpoint_requests.h"

#include <absl/strings/str_format.h>

namespace craftfleet {

absl::StatusOr<int64_t> CheckpointRequests::Ask(absl::Duration timeout) {
  const MutexLock lock(&mu_);
  asked_ = true;
  const int64_t before = answers_;
  changed_.WaitFor(&mu_, timeout, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return answers_ > before || closed_; });
  if (answers_ > before) return answer_;
  if (closed_)
    return absl::UnavailableError("training has ended: the last checkpoint is written before the learner exits");
  return absl::DeadlineExceededError(absl::StrFormat(
      "no checkpoint within %s: it will be written after the current update", absl::FormatDuration(timeout)));
}

bool CheckpointRequests::pending() const {
  const MutexLock lock(&mu_);
  return asked_;
}

void CheckpointRequests::Answer(const absl::StatusOr<int64_t>& iteration) {
  const MutexLock lock(&mu_);
  asked_ = false;
  answer_ = iteration;
  ++answers_;
  changed_.NotifyAll();
}

void CheckpointRequests::Close() {
  const MutexLock lock(&mu_);
  closed_ = true;
  changed_.NotifyAll();
}

}  // namespace craftfleet
