// How fast something happens now.

#ifndef CRAFTFLEET_COMMON_RATE_METER_H_
#define CRAFTFLEET_COMMON_RATE_METER_H_

#include <algorithm>
#include <array>
#include <cstdint>

#include <absl/time/time.h>

#include "common/clock.h"
#include "common/mutex.h"

namespace craftfleet {

// Counts events over the last `kSeconds` whole seconds. Thread-safe.
class RateMeter {
 public:
  static constexpr int kSeconds = 10;

  // `clock` outlives the meter.
  explicit RateMeter(Clock* clock) : clock_(clock), start_(absl::ToUnixSeconds(clock->Now())) {}

  void Add(int64_t events) ABSL_LOCKS_EXCLUDED(mu_) {
    const int64_t now = absl::ToUnixSeconds(clock_->Now());
    MutexLock lock(&mu_);
    Second& second = seconds_[now % kSeconds];
    if (second.time != now) second = {now, 0};
    second.events += events;
  }

  // Events per second: over the whole seconds that lie behind, at most kSeconds - 1 of them; 0 in the first.
  double PerSecond() const ABSL_LOCKS_EXCLUDED(mu_) {
    const int64_t now = absl::ToUnixSeconds(clock_->Now());
    const int64_t first = std::max(now - kSeconds + 1, start_);
    if (first >= now) return 0;
    MutexLock lock(&mu_);
    int64_t events = 0;
    for (const Second& second : seconds_) {
      if (second.time >= first && second.time < now) events += second.events;
    }
    return static_cast<double>(events) / static_cast<double>(now - first);
  }

 private:
  struct Second {
    int64_t time = -1;  // since 1970
    int64_t events = 0;
  };

  Clock* const clock_;
  const int64_t start_;
  mutable Mutex mu_;
  std::array<Second, kSeconds> seconds_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_RATE_METER_H_
