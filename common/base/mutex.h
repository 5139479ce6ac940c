// A mutex, its lock and a condition variable: std's types with Abseil's thread annotations. ThreadSanitizer understands
// std's types, but not the packaged absl::Mutex.

#pragma once

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>

#include <absl/base/thread_annotations.h>
#include <absl/time/time.h>

namespace craftfleet {

class ABSL_LOCKABLE Mutex {
 public:
  void Lock() ABSL_EXCLUSIVE_LOCK_FUNCTION() { mu_.lock(); }
  void Unlock() ABSL_UNLOCK_FUNCTION() { mu_.unlock(); }

 private:
  friend class CondVar;
  std::mutex mu_;
};

class ABSL_SCOPED_LOCKABLE MutexLock {
 public:
  explicit MutexLock(Mutex* mu) ABSL_EXCLUSIVE_LOCK_FUNCTION(mu) : mu_(mu) { mu_->Lock(); }
  ~MutexLock() ABSL_UNLOCK_FUNCTION() { mu_->Unlock(); }
  MutexLock(const MutexLock&) = delete;
  MutexLock& operator=(const MutexLock&) = delete;

 private:
  Mutex* const mu_;
};

class CondVar {
 public:
  void NotifyAll() { cv_.notify_all(); }

  // Waits until `predicate()` holds; it is called with `mu` held.
  template <typename Predicate>
  void Wait(Mutex* mu, Predicate predicate) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) {
    std::unique_lock<std::mutex> lock(mu->mu_, std::adopt_lock);
    cv_.wait(lock, predicate);
    lock.release();
  }

  // As Wait, for at most `timeout`, which may be infinite. Returns the last value of `predicate()`.
  template <typename Predicate>
  bool WaitFor(Mutex* mu, absl::Duration timeout, Predicate predicate) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) {
    std::unique_lock<std::mutex> lock(mu->mu_, std::adopt_lock);
    // wait_for adds the timeout to the current time, which must not overflow.
    timeout = std::min(timeout, absl::Hours(24 * 365));
    const bool held = cv_.wait_for(lock, absl::ToChronoNanoseconds(timeout), predicate);
    lock.release();
    return held;
  }

 private:
  std::condition_variable cv_;
};

}  // namespace craftfleet
