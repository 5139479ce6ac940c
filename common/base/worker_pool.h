// A fixed set of threads that work on the parts of one job.

#pragma once

#include <functional>
#include <thread>
#include <vector>

#include "common/base/mutex.h"

namespace craftfleet {

// Used by one thread, which takes part in the work: only `threads` - 1 are started.
class WorkerPool {
 public:
  // `threads` >= 1. Each started thread calls `on_start` first.   Throws std::system_error: the system refuses a
  // thread.
  WorkerPool(int threads, const std::function<void()>& on_start);
  ~WorkerPool();
  WorkerPool(const WorkerPool&) = delete;
  WorkerPool& operator=(const WorkerPool&) = delete;

  // Calls `part(i)` once for each i of 0..count-1, in any order and on any of the threads; returns when all have
  // returned. What the parts wrote is then visible to the caller.
  void Run(int count, const std::function<void(int)>& part) ABSL_LOCKS_EXCLUDED(mu_);

  int threads() const { return static_cast<int>(threads_.size()) + 1; }

 private:
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);
  void WorkUntilStopped() ABSL_LOCKS_EXCLUDED(mu_);
  // Runs parts until all have been started.
  void TakeParts() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  Mutex mu_;
  CondVar changed_;
  const std::function<void(int)>* part_ ABSL_GUARDED_BY(mu_) = nullptr;  // of the running job
  int next_ ABSL_GUARDED_BY(mu_) = 0;                                    // first part that has not been started
  int count_ ABSL_GUARDED_BY(mu_) = 0;
  int unfinished_ ABSL_GUARDED_BY(mu_) = 0;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::vector<std::thread> threads_;  // constant after construction
};

}  // namespace craftfleet
