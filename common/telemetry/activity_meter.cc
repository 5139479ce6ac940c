#include "common/telemetry/activity_meter.h"

#include <algorithm>

namespace craftfleet {
namespace {

constexpr std::array<absl::string_view, kNumActivities> kNames = {"environment", "wire",   "inference", "permits",
                                                                  "intake",      "update", "other",     "idle"};

constexpr absl::Duration kMarkEvery = absl::Seconds(2);

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

void Work::Add(const Work& other) {
  seconds += other.seconds;
  times.Add(other.times);
  done += other.done;
  per_second += other.per_second;
}

ActivityMeter::ActivityMeter(Clock* clock, Activity first)
    : clock_(clock),
      activity_(first),
      switched_(clock->Now()),
      start_{switched_, {}, 0},
      now_(start_),
      marks_{start_} {}

absl::Duration ActivityMeter::Switch(Activity next) { return Switch(next, next, absl::ZeroDuration()); }

absl::Duration ActivityMeter::Switch(Activity next, Activity within, absl::Duration spent) {
  const absl::Time time = clock_->Now();
  const MutexLock lock(&mu_);
  const absl::Duration lasted = std::max(absl::ZeroDuration(), time - switched_);
  const double moved = absl::ToDoubleSeconds(std::clamp(spent, absl::ZeroDuration(), lasted));
  Advance(time);
  now_.times[activity_] -= moved;
  now_.times[within] += moved;
  activity_ = next;
  switched_ = time;
  return lasted;
}

void ActivityMeter::Count(int64_t done) {
  const absl::Time time = clock_->Now();
  const MutexLock lock(&mu_);
  Advance(time);
  now_.done += done;
}

void ActivityMeter::BeginCycle() {
  const absl::Time time = clock_->Now();
  const MutexLock lock(&mu_);
  Advance(time);
  finished_cycle_ = cycle_;
  cycle_ = now_;
}

void ActivityMeter::Advance(absl::Time time) const {
  if (time <= now_.time) return;  // the clock was set back
  // The activity has not changed since the last mark, so the marks that were due meanwhile can be added now.
  const absl::Time first_kept = time - ActivityMeter::kWindow - kMarkEvery;
  while (marks_.back().time + kMarkEvery <= time) {
    const absl::Time next = std::max(marks_.back().time + kMarkEvery, std::min(first_kept, time));
    Mark mark = now_;
    mark.times[activity_] += std::max(0.0, absl::ToDoubleSeconds(next - now_.time));
    mark.time = next;
    marks_.push_back(mark);
  }
  while (marks_.size() > 1 && marks_[1].time <= time - kWindow) marks_.pop_front();
  now_.times[activity_] += absl::ToDoubleSeconds(time - now_.time);
  now_.time = time;
}

Work ActivityMeter::Between(const Mark& begin, const Mark& end) {
  Work work;
  for (const Activity activity : kActivities) {
    // A mark inside a span that was later split between two activities is off by the moved part.
    work.times[activity] = std::max(0.0, end.times[activity] - begin.times[activity]);
  }
  work.seconds = work.times.Sum();
  work.done = end.done - begin.done;
  const double elapsed = absl::ToDoubleSeconds(end.time - begin.time);
  work.per_second = elapsed > 0 ? static_cast<double>(work.done) / elapsed : 0;
  return work;
}

Work ActivityMeter::Total() const {
  const absl::Time time = clock_->Now();
  const MutexLock lock(&mu_);
  Advance(time);
  Work work = Between(start_, now_);
  for (const Activity activity : kActivities) {
    double& most = most_[activity];
    most = work.times[activity] = std::max(most, work.times[activity]);
  }
  return work;
}

Work ActivityMeter::Recent() const {
  const absl::Time time = clock_->Now();
  const MutexLock lock(&mu_);
  Advance(time);
  const Mark& mark = marks_.front();
  return Between(finished_cycle_.has_value() && finished_cycle_->time < mark.time ? *finished_cycle_ : mark, now_);
}

}  // namespace craftfleet
