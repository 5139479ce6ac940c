// A clock that the test advances.

#pragma once

#include <absl/base/thread_annotations.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"

namespace craftfleet {

// Thread-safe. Both its times start at 2023-11-14 22:13:20 UTC.
class FakeClock : public Clock {
 public:
  absl::Time Now() override ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    return now_;
  }
  absl::Time WallNow() override ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    return now_ + wall_ahead_;
  }
  // Sets the date `by` ahead of the monotonic time; negative: behind it.
  void SetWallAhead(absl::Duration by) ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    wall_ahead_ = by;
  }
  void Advance(absl::Duration by) ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    now_ += by;
  }

 private:
  Mutex mu_;
  absl::Time now_ ABSL_GUARDED_BY(mu_) = absl::FromUnixSeconds(1'700'000'000);
  absl::Duration wall_ahead_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet
