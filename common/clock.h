// Time as a parameter, so that tests need not wait.

#ifndef CRAFTFLEET_COMMON_CLOCK_H_
#define CRAFTFLEET_COMMON_CLOCK_H_

#include <chrono>

#include <absl/time/clock.h>
#include <absl/time/time.h>

namespace craftfleet {

// Time since the host started, as if that had been 1970: only grows, whatever is done to the date. For everything that
// is measured or waited for.
inline absl::Time SteadyNow() {
  return absl::UnixEpoch() + absl::FromChrono(std::chrono::steady_clock::now().time_since_epoch());
}

// Thread-safe.
class Clock {
 public:
  virtual ~Clock() = default;
  // Steady, see SteadyNow: for leases, deadlines and durations. Means nothing on another host or after a restart of it.
  virtual absl::Time Now() = 0;
  // The date, which people and programs may set at will: for what is written down, never to be waited for.
  virtual absl::Time WallNow() = 0;
};

class RealClock : public Clock {
 public:
  absl::Time Now() override { return SteadyNow(); }
  absl::Time WallNow() override { return absl::Now(); }
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_CLOCK_H_
