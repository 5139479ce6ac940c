// Runs functions later.

#ifndef CRAFTFLEET_TESTS_CHAOS_TIMER_H_
#define CRAFTFLEET_TESTS_CHAOS_TIMER_H_

#include <functional>
#include <map>
#include <thread>
#include <utility>

#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"

namespace craftfleet {

// Runs functions at given times, on one thread.
class Timer {
 public:
  Timer() : thread_([this] { Run(); }) {}
  ~Timer() {
    {
      const MutexLock lock(&mu_);
      stopping_ = true;
      changed_.NotifyAll();
    }
    thread_.join();
  }
  void After(absl::Duration delay, std::function<void()> function) {
    const MutexLock lock(&mu_);
    const absl::Time time = SteadyNow() + delay;
    const bool is_first = due_.empty() || time < due_.begin()->first;
    due_.emplace(time, std::move(function));
    if (is_first) changed_.NotifyAll();
  }

 private:
  void Run() {
    while (true) {
      std::function<void()> function;
      {
        const MutexLock lock(&mu_);
        if (stopping_) return;
        const absl::Duration wait = due_.empty() ? absl::Seconds(1) : due_.begin()->first - SteadyNow();
        if (due_.empty() || wait > absl::ZeroDuration()) {
          const absl::Time first = due_.empty() ? absl::InfiniteFuture() : due_.begin()->first;
          changed_.WaitFor(&mu_, wait, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
            return stopping_ || (!due_.empty() && due_.begin()->first < first);
          });
          continue;
        }
        function = std::move(due_.begin()->second);
        due_.erase(due_.begin());
      }
      function();
    }
  }

  Mutex mu_;
  CondVar changed_;
  std::multimap<absl::Time, std::function<void()>> due_ ABSL_GUARDED_BY(mu_);
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_CHAOS_TIMER_H_
