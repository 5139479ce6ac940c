// The activities by which the time of a run's threads is broken down.

#ifndef CRAFTFLEET_COMMON_TELEMETRY_ACTIVITY_H_
#define CRAFTFLEET_COMMON_TELEMETRY_ACTIVITY_H_

#include <array>
#include <cstddef>
#include <optional>

#include <absl/strings/string_view.h>

namespace craftfleet {

enum class Activity {
  kEnvironment,  // stepping, drawing and opening games
  kWire,         // transferring messages and weights
  kInference,    // evaluating the policy
  kPermits,      // waiting for a permit, in an actor
  kIntake,       // waiting for fragments, in the learner
  kUpdate,       // PPO update
  kOther,        // advantages, logs, checkpoints, ...
  kIdle,         // waiting for actors, in an environment server
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

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_TELEMETRY_ACTIVITY_H_
