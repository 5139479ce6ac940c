// A bounded queue between threads that can be closed.

#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <utility>

#include <absl/status/status.h>
#include <absl/time/time.h>

#include "common/base/mutex.h"

namespace craftfleet {

// First in, first out. Thread-safe.
template <typename T>
class ClosableQueue {
 public:
  explicit ClosableQueue(size_t capacity) : capacity_(capacity) {}

  // Appends `item`; blocks while the queue is full.   Cancelled: `Close` was called; the item is dropped.
  absl::Status Push(T item) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    changed_.Wait(&mu_, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return closed_ || items_.size() < capacity_; });
    if (closed_) return absl::CancelledError("queue closed");
    items_.push_back(std::move(item));
    changed_.NotifyAll();
    return absl::OkStatus();
  }

  // Removes and returns the oldest item; waits up to `timeout` for one. nullopt: timeout, or closed and drained.
  std::optional<T> Pop(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    changed_.WaitFor(&mu_, timeout, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return closed_ || !items_.empty(); });
    if (items_.empty()) return std::nullopt;
    T item = std::move(items_.front());
    items_.pop_front();
    changed_.NotifyAll();
    return item;
  }

  // Refuses further items and wakes every waiter; items already queued can still be popped. Idempotent.
  void Close() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    closed_ = true;
    changed_.NotifyAll();
  }

  size_t size() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return items_.size();
  }

 private:
  const size_t capacity_;  // items
  mutable Mutex mu_;
  CondVar changed_;
  std::deque<T> items_ ABSL_GUARDED_BY(mu_);
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet
