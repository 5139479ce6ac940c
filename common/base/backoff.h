// Pauses between attempts: exponential backoff with jitter.

#pragma once

#include <algorithm>
#include <random>

#include <absl/time/time.h>

namespace craftfleet {

// Each pause is twice the previous one, up to a limit, and is then shortened at random by up to half, so that the
// workers of a fleet that lost its learner do not all reconnect at the same moment. Thread-compatible.
class Backoff {
 public:
  Backoff(absl::Duration first, absl::Duration limit) : first_(first), limit_(limit), pause_(first) {}

  // The next pause, drawn from 50% to 100% of the nominal one.
  absl::Duration Next() {
    const absl::Duration pause = pause_;
    pause_ = std::min(2 * pause_, limit_);
    return pause * std::uniform_real_distribution<double>(0.5, 1)(random_);
  }
  // To be called after a success: the next failure starts again with the first pause.
  void Reset() { pause_ = first_; }

 private:
  const absl::Duration first_;
  const absl::Duration limit_;
  absl::Duration pause_;
  std::minstd_rand random_{std::random_device()()};
};

}  // namespace craftfleet
