// The request to stop training.

#pragma once

#include <atomic>

#include <absl/time/time.h>

#include "common/base/mutex.h"

namespace craftfleet {

// Set once, never cleared. Thread-safe.
class StopFlag {
 public:
  void Set() ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    set_ = true;
    changed_.NotifyAll();
  }
  bool is_set() const { return set_; }
  // Sleeps for `duration`; returns early when the flag is set. Returns whether it is.
  bool Sleep(absl::Duration duration) const ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    return changed_.WaitFor(&mu_, duration, [this] { return set_.load(); });
  }

 private:
  std::atomic<bool> set_{false};
  mutable Mutex mu_;
  mutable CondVar changed_;
};

}  // namespace craftfleet
