// Free memory goes back to the system.

#ifndef CRAFTFLEET_COMMON_HEAP_TRIMMER_H_
#define CRAFTFLEET_COMMON_HEAP_TRIMMER_H_

#include <malloc.h>

#include <absl/time/time.h>

#include "common/clock.h"

namespace craftfleet {

// Each of malloc's arenas keeps the most that its threads have ever held at once. Where threads come and go with their
// connections and each may take in megabytes, that adds up in the course of a run. Owned by one thread.
class HeapTrimmer {
 public:
  // `clock` outlives the trimmer.
  explicit HeapTrimmer(Clock* clock) : clock_(clock), next_(clock->Now() + kEvery) {}

  // Gives back what is free, if ten seconds have passed since the last time; some milliseconds then, in which
  // allocations wait.
  void MayTrim() {
    if (clock_->Now() < next_) return;
    next_ = clock_->Now() + kEvery;
    malloc_trim(0);
  }

 private:
  static constexpr absl::Duration kEvery = absl::Seconds(10);

  Clock* const clock_;
  absl::Time next_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_HEAP_TRIMMER_H_
