// Time as a parameter, so that tests need not wait.

#ifndef CRAFTFLEET_COMMON_CLOCK_H_
#define CRAFTFLEET_COMMON_CLOCK_H_

#include <absl/time/clock.h>
#include <absl/time/time.h>

namespace craftfleet {

// Thread-safe.
class Clock {
 public:
  virtual ~Clock() = default;
  virtual absl::Time Now() = 0;
};

class RealClock : public Clock {
 public:
  absl::Time Now() override { return absl::Now(); }
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_CLOCK_H_
