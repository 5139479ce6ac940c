// Time as a parameter, so that tests do not have to wait.

#pragma once

#include <chrono>

#include <absl/time/clock.h>
#include <absl/time/time.h>

namespace craftfleet {

// Monotonic time since the host started, counted from the Unix epoch. Changes of the system date do not affect it. For
// every measurement, timeout and deadline.
inline absl::Time SteadyNow() {
  return absl::UnixEpoch() + absl::FromChrono(std::chrono::steady_clock::now().time_since_epoch());
}

// Thread-safe.
class Clock {
 public:
  virtual ~Clock() = default;
  // Monotonic, see SteadyNow: for leases, deadlines and durations. Not comparable between hosts or across a reboot.
  virtual absl::Time Now() = 0;
  // The system date, which may jump when it is set: for timestamps in files and logs, never for timeouts.
  virtual absl::Time WallNow() = 0;
};

class RealClock : public Clock {
 public:
  absl::Time Now() override { return SteadyNow(); }
  absl::Time WallNow() override { return absl::Now(); }
};

}  // namespace craftfleet
