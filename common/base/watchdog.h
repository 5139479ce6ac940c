// Deadlines for operations: a callback for each one that takes too long.

#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <thread>

#include <absl/time/time.h>

#include "common/base/mutex.h"

namespace craftfleet {

// One thread that serves any number of timers, on a steady clock. Arming and disarming a timer costs a lock, which is
// cheap enough for each request. Time in which this process did not run (it was stopped, or its machine slept) does not
// count. Thread-safe.
class Watchdog {
 public:
  // Calls back when it has been armed for longer than its limit. Thread-compatible.
  class Timer {
   public:
    // `on_overdue` is called on the watchdog's thread, at most once per Arm, never after Disarm has returned. It must
    // be short and must not use a timer of this watchdog. `watchdog` outlives the timer.
    Timer(Watchdog* watchdog, std::function<void()> on_overdue);
    ~Timer();
    Timer(const Timer&) = delete;
    Timer& operator=(const Timer&) = delete;

    // The timer becomes overdue `limit` from now; InfiniteDuration: never.
    void Arm(absl::Duration limit);
    // Returns whether the timer was overdue.
    bool Disarm();

   private:
    Watchdog* const watchdog_;
    const int64_t id_;
  };

  Watchdog();
  // All timers must have been destroyed before.
  ~Watchdog();

  // The watchdog that the whole process shares; never destroyed.
  static Watchdog* OfProcess();

 private:
  using Clock = std::chrono::steady_clock;
  struct Entry {
    std::function<void()> on_overdue;
    Clock::time_point deadline = Clock::time_point::max();  // max: not armed
    bool overdue = false;
  };

  int64_t Add(std::function<void()> on_overdue) ABSL_LOCKS_EXCLUDED(mu_);
  void Remove(int64_t id) ABSL_LOCKS_EXCLUDED(mu_);
  void Arm(int64_t id, absl::Duration limit) ABSL_LOCKS_EXCLUDED(mu_);
  bool Disarm(int64_t id) ABSL_LOCKS_EXCLUDED(mu_);
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Calls the callbacks of overdue timers; returns the earliest deadline of the others.
  Clock::time_point Check(Clock::time_point now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Extends all deadlines by the time in which the process was stopped.
  void Forgive(Clock::duration pause) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  Mutex mu_;
  CondVar changed_;
  std::map<int64_t, Entry> timers_ ABSL_GUARDED_BY(mu_);
  int64_t next_id_ ABSL_GUARDED_BY(mu_) = 0;
  Clock::time_point wake_ ABSL_GUARDED_BY(mu_) = Clock::time_point::max();  // when the thread checks next
  bool earlier_ ABSL_GUARDED_BY(mu_) = false;                               // it must check before that
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace craftfleet
