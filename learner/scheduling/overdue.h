// How long an actor may have something that the learner waits for.

#pragma once

#include <cstddef>
#include <deque>

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
  void Add(absl::Duration time);
  absl::Duration Limit() const { return limit_; }

 private:
  const absl::Duration least_;
  absl::Duration limit_;
  std::deque<absl::Duration> times_;
};

}  // namespace craftfleet
