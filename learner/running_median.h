// The median of values that are added one by one.

#ifndef CRAFTFLEET_LEARNER_RUNNING_MEDIAN_H_
#define CRAFTFLEET_LEARNER_RUNNING_MEDIAN_H_

#include <functional>
#include <optional>
#include <queue>
#include <vector>

#include <absl/time/time.h>

namespace craftfleet {

// Adding takes logarithmic time, the median none: it is asked for far more often. Not thread-safe.
class RunningMedian {
 public:
  void Add(absl::Duration value) {
    if (!upper_.empty() && value < upper_.top()) {
      lower_.push(value);
    } else {
      upper_.push(value);
    }
    const size_t half = (lower_.size() + upper_.size()) / 2;
    if (lower_.size() > half) {
      upper_.push(lower_.top());
      lower_.pop();
    } else if (lower_.size() < half) {
      lower_.push(upper_.top());
      upper_.pop();
    }
  }
  void Clear() { *this = RunningMedian(); }

  // Of an even number of values, the larger of the two in the middle. nullopt: there are none.
  std::optional<absl::Duration> Get() const { return upper_.empty() ? std::nullopt : std::make_optional(upper_.top()); }

 private:
  std::priority_queue<absl::Duration> lower_;  // the smaller half
  std::priority_queue<absl::Duration, std::vector<absl::Duration>, std::greater<>> upper_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUNNING_MEDIAN_H_
