// Waits for the effect of another thread or process.

#pragma once

#include <functional>

#include <absl/time/clock.h>
#include <absl/time/time.h>

namespace craftfleet {

// Returns true as soon as `condition` holds; false if it does not hold within `timeout`.
inline bool WaitUntil(const std::function<bool()>& condition, absl::Duration timeout = absl::Seconds(30)) {
  for (const absl::Time deadline = absl::Now() + timeout; absl::Now() < deadline;
       absl::SleepFor(absl::Milliseconds(1))) {
    if (condition()) return true;
  }
  return condition();
}

}  // namespace craftfleet
