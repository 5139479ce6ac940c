// Calls that wait for a change without a thread each.

#ifndef CRAFTFLEET_COMMON_BASE_WAITING_CALLS_H_
#define CRAFTFLEET_COMMON_BASE_WAITING_CALLS_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <thread>
#include <unordered_map>
#include <utility>
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
  // What had changed when an attempt began.
  struct Moment {
    int64_t round = 0;    // calls of Retry for all
    int64_t retries = 0;  // calls of Retry for callers in the same bucket
    friend bool operator!=(const Moment& a, const Moment& b) { return a.round != b.round || a.retries != b.retries; }
  };
  struct Call {
    Attempt attempt;
    absl::Time deadline;
    std::string caller;
    Moment tried;  // the last attempt
  };
  static constexpr size_t kBuckets = 4096;
  static constexpr size_t kAtOnce = 64;  // calls taken with the lock held once, for which Retry may have to wait

  static size_t BucketOf(absl::string_view caller) { return Fnv1a(kFnv1aBasis, caller) % kBuckets; }
  Moment Now(absl::string_view caller) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Moment LockedNow(absl::string_view caller) const ABSL_LOCKS_EXCLUDED(mu_);
  void Keep(Call call) ABSL_LOCKS_EXCLUDED(mu_);
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Waits for calls that are due: their deadline has passed, or a Retry came after their last attempt. Returns some;
  // none: the object is being destroyed.
  std::vector<Call> AwaitDue() ABSL_LOCKS_EXCLUDED(mu_);
  // The number of a call that is due; 0: none.
  int64_t NextDue(absl::Time now) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Call Take(int64_t number) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  mutable Mutex mu_;
  CondVar changed_;
  // Those that wait, by number, and ordered in all the ways in which they come due.
  std::unordered_map<int64_t, Call> calls_ ABSL_GUARDED_BY(mu_);
  std::set<std::pair<absl::Time, int64_t>> by_deadline_ ABSL_GUARDED_BY(mu_);
  std::set<std::pair<int64_t, int64_t>> by_round_ ABSL_GUARDED_BY(mu_);  // of their last attempt
  std::multimap<std::string, int64_t, std::less<>> by_caller_ ABSL_GUARDED_BY(mu_);
  std::set<int64_t> retried_ ABSL_GUARDED_BY(mu_);  // because of a Retry of their caller
  int64_t last_number_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t round_ ABSL_GUARDED_BY(mu_) = 0;
  std::vector<int64_t> retries_ ABSL_GUARDED_BY(mu_) = std::vector<int64_t>(kBuckets);
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_BASE_WAITING_CALLS_H_
