#include "common/telemetry/activity.h"

namespace craftfleet {
namespace {

constexpr std::array<absl::string_view, kNumActivities> kNames = {"environment", "wire",   "inference", "permits",
                                                                  "intake",      "update", "other",     "idle"};

}  // namespace

absl::string_view ActivityName(Activity activity) { return kNames[static_cast<size_t>(activity)]; }

std::optional<Activity> ActivityByName(absl::string_view name) {
  for (const Activity activity : kActivities) {
    if (ActivityName(activity) == name) return activity;
  }
  return std::nullopt;
}

double ByActivity::Sum() const {
  double sum = 0;
  for (const double value : values_) sum += value;
  return sum;
}

void ByActivity::Add(const ByActivity& other, double factor) {
  for (size_t i = 0; i < values_.size(); ++i) values_[i] += factor * other.values_[i];
}

ByActivity ByActivity::Normalized() const {
  ByActivity parts;
  if (const double sum = Sum(); sum > 0) parts.Add(*this, 1 / sum);
  return parts;
}

}  // namespace craftfleet
