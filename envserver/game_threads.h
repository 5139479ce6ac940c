// The threads that play the games of all sessions.

#pragma once

#include <atomic>
#include <cstddef>
#include <deque>
#include <functional>
#include <thread>
#include <vector>

#include "common/base/mutex.h"

namespace craftfleet {

// Runs jobs in the order in which they were added. Each session has at most one job at a time, so the threads serve
// sessions in turn. Thread-safe.
class GameThreads {
 public:
  // Starts `threads` threads, at least 1.
  explicit GameThreads(int threads);
  // Runs the jobs that were added before.
  ~GameThreads();
  GameThreads(const GameThreads&) = delete;
  GameThreads& operator=(const GameThreads&) = delete;

  // `job` must not throw.
  void Add(std::function<void()> job) ABSL_LOCKS_EXCLUDED(mu_);
  // Whether a job waits for a thread: a long one should add its rest as a new job. Cheap.
  bool others_wait() const { return waiting_.load(std::memory_order_relaxed) > 0; }

 private:
  // A thread that waits for a job, or for the end.
  struct Idle {
    CondVar called;
    bool is_called = false;
  };

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Waits for a job and takes it; null: there will be no more.
  std::function<void()> Take() ABSL_LOCKS_EXCLUDED(mu_);
  void CallIdle() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  Mutex mu_;
  std::vector<Idle*> idle_ ABSL_GUARDED_BY(mu_);  // the last one has the warmest caches
  std::deque<std::function<void()>> jobs_ ABSL_GUARDED_BY(mu_);
  std::atomic<size_t> waiting_{0};  // size of jobs_
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::vector<std::thread> threads_;  // constant after construction
};

}  // namespace craftfleet
