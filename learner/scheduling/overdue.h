// How long an actor may have something that the learner waits for.

#pragma once

#include <algorithm>
#include <cstddef>
#include <deque>
#include <vector>

#include <absl/time/time.h>

namespace craftfleet {

// A fragment or evaluation task is overdue if its newest player has had it for several times the median of the last
// results, whatever its players report. It is then given to one more actor; the first result counts. A median, so that
// a few players that dawdle over their results do not stretch the limit. Not thread-safe.
class Overdue {
 public:
  static constexpr int kSeveral = 4;
  static constexpr size_t kKept = 101;  // results

  // The limit is at least `least`, and `at_first` while there are no results.
  Overdue(absl::Duration least, absl::Duration at_first) : least_(least), limit_(at_first) {}

  // A result has come, `time` after its player got the permit or task.
  void Add(absl::Duration time) {
    times_.push_back(time);
    if (times_.size() > kKept) times_.pop_front();
    std::vector<absl::Duration> times(times_.begin(), times_.end());
    const auto middle = times.begin() + static_cast<std::ptrdiff_t>((times.size() - 1) / 2);
    std::nth_element(times.begin(), middle, times.end());
    limit_ = std::max(least_, kSeveral * *middle);
  }
  absl::Duration Limit() const { return limit_; }

 private:
  const absl::Duration least_;
  absl::Duration limit_;
  std::deque<absl::Duration> times_;
};

}  // namespace craftfleet
