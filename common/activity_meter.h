// Where a thread's time goes, and how much it gets done.

#ifndef CRAFTFLEET_COMMON_ACTIVITY_METER_H_
#define CRAFTFLEET_COMMON_ACTIVITY_METER_H_

#include <cstdint>
#include <deque>
#include <optional>

#include <absl/time/time.h>

#include "common/activity.h"
#include "common/clock.h"
#include "common/mutex.h"

namespace craftfleet {

// Seconds by activity and what was done in them, over some span of time.
struct Work {
  double seconds = 0;     // how long that span is; of several threads together
  ByActivity times;       // seconds; their sum is `seconds`
  int64_t done = 0;       // steps, of whatever kind the thread does
  double per_second = 0;  // of what is done: the sum over threads

  // Takes in another thread.
  void Add(const Work& other);
};

// Belongs to one thread, which is at exactly one activity at any time. The activity under way counts up to the moment
// of asking, so that an hour's update shows while it lasts. Thread-safe; Switch costs about 0.1 us.
class ActivityMeter {
 public:
  static constexpr absl::Duration kWindow = absl::Seconds(20);

  // `clock` outlives the meter.
  ActivityMeter(Clock* clock, Activity first);

  // Ends the activity under way, begins `next`, and returns how long the one that ended had lasted.
  absl::Duration Switch(Activity next) ABSL_LOCKS_EXCLUDED(mu_);
  // The same; `spent` of the time that ends now was spent on `within`.
  absl::Duration Switch(Activity next, Activity within, absl::Duration spent) ABSL_LOCKS_EXCLUDED(mu_);
  // Counts what was done.
  void Count(int64_t done) ABSL_LOCKS_EXCLUDED(mu_);
  // A round of work begins, such as an iteration: Recent looks back over at least one whole round.
  void BeginCycle() ABSL_LOCKS_EXCLUDED(mu_);

  // Since the meter was made.
  Work Total() const ABSL_LOCKS_EXCLUDED(mu_);
  // Over the last kWindow, or since the beginning of the last finished cycle if that is longer ago.
  Work Recent() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Mark {
    absl::Time time;
    ByActivity times;
    int64_t done = 0;
  };

  // Brings now_ up to `time`.
  void Advance(absl::Time time) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  static Work Between(const Mark& begin, const Mark& end);

  Clock* const clock_;
  mutable Mutex mu_;
  Activity activity_ ABSL_GUARDED_BY(mu_);
  absl::Time switched_ ABSL_GUARDED_BY(mu_);  // when it began
  const Mark start_;
  mutable Mark now_ ABSL_GUARDED_BY(mu_);
  mutable std::deque<Mark> marks_ ABSL_GUARDED_BY(mu_);      // about the window's age and younger, oldest first
  std::optional<Mark> finished_cycle_ ABSL_GUARDED_BY(mu_);  // where the last finished cycle began
  std::optional<Mark> cycle_ ABSL_GUARDED_BY(mu_);           // where the one under way began
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_ACTIVITY_METER_H_
