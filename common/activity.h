// What the threads of a run spend their time on.

#ifndef CRAFTFLEET_COMMON_ACTIVITY_H_
#define CRAFTFLEET_COMMON_ACTIVITY_H_

#include <array>
#include <cstddef>
#include <optional>

#include <absl/strings/string_view.h>

namespace craftfleet {

enum class Activity {
  kEnvironment,  // games are stepped and drawn, or opened
  kWire,         // messages and weights are on their way
  kInference,    // the policy acts
  kPermits,      // an actor waits for leave to play
  kIntake,       // the learner waits for fragments
  kUpdate,       // PPO
  kOther,        // advantages, logs, checkpoints, ...
  kIdle,         // an environment server waits for its actors
};
inline constexpr int kNumActivities = 8;

// "environment", "wire", ...
absl::string_view ActivityName(Activity activity);
std::optional<Activity> ActivityByName(absl::string_view name);

// A number for each activity: seconds, or parts of one.
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

#endif  // CRAFTFLEET_COMMON_ACTIVITY_H_
