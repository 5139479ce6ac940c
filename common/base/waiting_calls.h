// Calls that wait for a change without a thread each.

#ifndef CRAFTFLEET_COMMON_BASE_WAITING_CALLS_H_
#define CRAFTFLEET_COMMON_BASE_WAITING_CALLS_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <thread>
#include <vector>

#include <absl/time/time.h>

#include "common/base/mutex.h"

namespace craftfleet {

// A single thread, started with the first call that has to wait, answers all that wait. When an iteration opens, a
// thousand calls can be answered; as many threads would keep others, such as those that show status, off the CPU.
// Thread-safe.
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

  // Makes the first attempt itself. If that fails the thread repeats it after each Retry, for the last time after
  // `wait`. Attempts must be safe on another thread and may outlive the caller.
  void Add(Attempt attempt, absl::Duration wait) ABSL_LOCKS_EXCLUDED(mu_);
  // Attempts may succeed now. Cheap; callers may hold their own locks.
  void Retry() ABSL_LOCKS_EXCLUDED(mu_);
  // Calls that wait.
  size_t size() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Call {
    Attempt attempt;
    absl::Time deadline;
    int64_t tried = 0;  // value of changes_ before the last attempt
  };

  int64_t changes() const ABSL_LOCKS_EXCLUDED(mu_);
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Waits for calls that are due: their deadline has passed, or Retry was called after their last attempt. Returns
  // them; none: the object is being destroyed.
  std::vector<Call> AwaitDue() ABSL_LOCKS_EXCLUDED(mu_);
  std::vector<Call> TakeDue() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void Keep(Call call) ABSL_LOCKS_EXCLUDED(mu_);

  mutable Mutex mu_;
  CondVar changed_;
  std::vector<Call> waiting_ ABSL_GUARDED_BY(mu_);
  absl::Time first_deadline_ ABSL_GUARDED_BY(mu_) = absl::InfiniteFuture();  // of `waiting_`, or earlier
  int64_t changes_ ABSL_GUARDED_BY(mu_) = 0;                                 // calls of Retry
  bool retry_ ABSL_GUARDED_BY(mu_) = false;                                  // a call may be due before its deadline
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_BASE_WAITING_CALLS_H_
