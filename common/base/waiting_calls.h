// Calls that wait for a change without a thread each.

#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <thread>
#include <vector>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/fnv1a.h"
#include "common/base/mutex.h"

namespace craftfleet {

// A single thread, started with the first call that has to wait, answers all that wait. When an iteration opens, a
// thousand calls can be answered; as many threads would keep others, such as those that show status, off the CPU.
// A change that concerns one caller costs no attempt of the others. Thread-safe.
class WaitingCalls {
 public:
  // Answers the call if that is possible, and always if `last`. Returns whether it did. Called without locks held, on
  // one thread at a time.
  using Attempt = std::function<bool(bool last)>;

  WaitingCalls() = default;
  // Makes the last attempt of the calls that still wait.
  ~WaitingCalls();
  WaitingCalls(const WaitingCalls&) = delete;
  WaitingCalls& operator=(const WaitingCalls&) = delete;

  // Makes the first attempt itself. If that fails the thread repeats it after each Retry that concerns `caller`, for
  // the last time after `wait`. Attempts must be safe on another thread and may outlive the caller.
  void Add(Attempt attempt, absl::Duration wait, absl::string_view caller = "") ABSL_LOCKS_EXCLUDED(mu_);
  // Attempts may succeed now: all of them, or those of one caller. Cheap; callers may hold their own locks.
  void Retry() ABSL_LOCKS_EXCLUDED(mu_);
  void Retry(absl::string_view caller) ABSL_LOCKS_EXCLUDED(mu_);
  // Calls that wait.
  size_t size() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Call {
    Attempt attempt;
    absl::Time deadline;
    size_t bucket = 0;  // of the caller
    int64_t tried = 0;  // changes before the last attempt
  };
  static constexpr size_t kBuckets = 4096;

  static size_t BucketOf(absl::string_view caller) { return Fnv1a(kFnv1aBasis, caller) % kBuckets; }
  // Calls of Retry so far that concern the callers of a bucket.
  int64_t Changes(size_t bucket) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return rounds_ + retries_[bucket]; }
  void Wake() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Keep(Call call) ABSL_LOCKS_EXCLUDED(mu_);
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Takes out the calls that are due: their deadline has passed, or a Retry came after their last attempt. Waits until
  // there are some; none: the object is being destroyed.
  std::vector<Call> AwaitDue() ABSL_LOCKS_EXCLUDED(mu_);

  mutable Mutex mu_;
  CondVar changed_;
  std::vector<Call> calls_ ABSL_GUARDED_BY(mu_);  // that wait
  int64_t rounds_ ABSL_GUARDED_BY(mu_) = 0;       // calls of Retry for all
  std::vector<int64_t> retries_ ABSL_GUARDED_BY(mu_) = std::vector<int64_t>(kBuckets);
  bool is_awake_ ABSL_GUARDED_BY(mu_) = false;                          // something has changed since the thread looked
  absl::Time next_look_ ABSL_GUARDED_BY(mu_) = absl::InfiniteFuture();  // the earliest deadline
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace craftfleet
