// How long to wait before the next try.

#ifndef CRAFTFLEET_COMMON_BACKOFF_H_
#define CRAFTFLEET_COMMON_BACKOFF_H_

#include <algorithm>
#include <random>

#include <absl/time/time.h>

namespace craftfleet {

// Exponential, with jitter: each pause is twice the last up to a limit, and up to half of it is left to chance, so that
// a fleet that lost its learner does not come back in step. Thread-compatible.
class Backoff {
 public:
  Backoff(absl::Duration first, absl::Duration limit) : first_(first), limit_(limit), pause_(first) {}

  // The next pause: between half of it and all of it.
  absl::Duration Next() {
    const absl::Duration pause = pause_;
    pause_ = std::min(2 * pause_, limit_);
    return pause * std::uniform_real_distribution<double>(0.5, 1)(random_);
  }
  // It went well: the next trouble begins with the first pause.
  void Reset() { pause_ = first_; }

 private:
  const absl::Duration first_;
  const absl::Duration limit_;
  absl::Duration pause_;
  std::minstd_rand random_{std::random_device()()};
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_BACKOFF_H_
