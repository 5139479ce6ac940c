// Measures how a thread spends its time by activity, and how many steps it completes.

#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"

namespace craftfleet {

enum class Activity {
  kEnvironment,  // stepping, drawing and opening games
  kWire,         // transferring messages and weights
  kInference,    // evaluating the policy
  kPermits,      // waiting for a permit, in an actor
  kIntake,       // waiting for fragments, in the learner
  kUpdate,       // PPO update
  kOther,        // advantages, logs, checkpoints, ...
  kIdle,         // waiting for actors, in an environment server; for evaluations, in the learner
};
inline constexpr int kNumActivities = 8;

// "environment", "wire", ...
absl::string_view ActivityName(Activity activity);
std::optional<Activity> ActivityByName(absl::string_view name);

// A number for each activity: seconds, or a share of 0..1.
class ByActivity {
 public:
  double& operator[](Activity activity) { return values_[static_cast<size_t>(activity)]; }
  double operator[](Activity activity) const { return values_[static_cast<size_t>(activity)]; }
  double Sum() const;
  // Adds `factor` times `other`.
  void Add(const ByActivity& other, double factor = 1);
  // Divided by the sum; all 0 if that is 0.
  ByActivity Normalized() const;

 private:
  std::array<double, kNumActivities> values_{};
};

inline constexpr std::array<Activity, kNumActivities> kActivities = {
    Activity::kEnvironment, Activity::kWire,   Activity::kInference, Activity::kPermits,
    Activity::kIntake,      Activity::kUpdate, Activity::kOther,     Activity::kIdle};

// Seconds by activity and the steps completed, over some span of time.
struct Work {
  double seconds = 0;     // length of the span; summed over threads
  ByActivity times;       // seconds; their sum is `seconds`
  int64_t done = 0;       // completed steps
  double per_second = 0;  // completed steps a second; summed over threads

  // Adds the work of another thread.
  void Add(const Work& other);
};

// Belongs to one thread, which has exactly one activity at any time. The current activity is included up to now, so an
// update of an hour shows while it runs. Thread-safe; Switch costs about 0.1 us.
class ActivityMeter {
 public:
  static constexpr absl::Duration kWindow = absl::Seconds(20);

  // `clock` outlives the meter.
  ActivityMeter(Clock* clock, Activity first);

  // Ends the current activity, begins `next`, and returns how long the ended one took.
  absl::Duration Switch(Activity next) ABSL_LOCKS_EXCLUDED(mu_);
  // The same, but attributes `spent` of the ended activity's time to `within`.
  absl::Duration Switch(Activity next, Activity within, absl::Duration spent) ABSL_LOCKS_EXCLUDED(mu_);
  // Counts `done` completed steps.
  void Count(int64_t done) ABSL_LOCKS_EXCLUDED(mu_);
  // Begins a cycle of work, such as an iteration: Recent covers at least one whole cycle.
  void BeginCycle() ABSL_LOCKS_EXCLUDED(mu_);

  // Since the meter was made. No activity's time falls: what was returned of a span that is split later stays until
  // the activity has lasted as long. Until then the times add up to more than `seconds`.
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
  absl::Time switched_ ABSL_GUARDED_BY(mu_);  // start of the current activity
  const Mark start_;
  mutable Mark now_ ABSL_GUARDED_BY(mu_);
  mutable ByActivity most_ ABSL_GUARDED_BY(mu_);             // that Total has returned
  mutable std::deque<Mark> marks_ ABSL_GUARDED_BY(mu_);      // about the window's age and younger, oldest first
  std::optional<Mark> finished_cycle_ ABSL_GUARDED_BY(mu_);  // where the last finished cycle began
  std::optional<Mark> cycle_ ABSL_GUARDED_BY(mu_);           // where the current one began
};

}  // namespace craftfleet
