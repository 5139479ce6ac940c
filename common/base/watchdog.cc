#include "common/base/watchdog.h"

#include <algorithm>
#include <utility>

namespace craftfleet {
namespace {

// While a timer is armed the thread wakes at least this often: a longer sleep shows that the process was stopped.
constexpr std::chrono::milliseconds kWakeEvery(500);
// If the thread wakes later than this, the process was stopped; a shorter delay is normal under load.
constexpr std::chrono::milliseconds kStoppedAfter(250);

}  // namespace

Watchdog::Timer::Timer(Watchdog* watchdog, std::function<void()> on_overdue)
    : watchdog_(watchdog), id_(watchdog->Add(std::move(on_overdue))) {}

Watchdog::Timer::~Timer() { watchdog_->Remove(id_); }

void Watchdog::Timer::Arm(absl::Duration limit) { watchdog_->Arm(id_, limit); }

bool Watchdog::Timer::Disarm() { return watchdog_->Disarm(id_); }

Watchdog::Watchdog() : thread_([this] { Run(); }) {}

Watchdog::~Watchdog() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    changed_.NotifyAll();
  }
  thread_.join();
}

Watchdog* Watchdog::OfProcess() {
  static Watchdog* const watchdog = new Watchdog;
  return watchdog;
}

int64_t Watchdog::Add(std::function<void()> on_overdue) {
  const MutexLock lock(&mu_);
  timers_[++next_id_].on_overdue = std::move(on_overdue);
  return next_id_;
}

void Watchdog::Remove(int64_t id) {
  const MutexLock lock(&mu_);
  timers_.erase(id);
}

void Watchdog::Arm(int64_t id, absl::Duration limit) {
  const MutexLock lock(&mu_);
  Entry& timer = timers_.at(id);
  timer.overdue = false;
  timer.deadline = Clock::time_point::max();
  if (limit == absl::InfiniteDuration()) return;
  timer.deadline = Clock::now() + absl::ToChronoNanoseconds(std::min(limit, absl::Hours(24 * 365)));
  // The thread wakes in time anyway, so consecutive requests do not have to wake it.
  if (timer.deadline >= wake_) return;
  earlier_ = true;
  changed_.NotifyAll();
}

bool Watchdog::Disarm(int64_t id) {
  const MutexLock lock(&mu_);
  Entry& timer = timers_.at(id);
  timer.deadline = Clock::time_point::max();
  return std::exchange(timer.overdue, false);
}

void Watchdog::Run() {
  const MutexLock lock(&mu_);
  while (!stopping_) {
    const Clock::time_point now = Clock::now();
    const Clock::time_point earliest = Check(now);
    wake_ = earliest == Clock::time_point::max() ? earliest : std::min(earliest, now + kWakeEvery);
    earlier_ = false;
    const absl::Duration pause =
        wake_ == Clock::time_point::max() ? absl::InfiniteDuration() : absl::FromChrono(wake_ - now);
    changed_.WaitFor(&mu_, pause, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || earlier_; });
    const Clock::time_point woken = Clock::now();
    if (wake_ != Clock::time_point::max() && woken - wake_ > kStoppedAfter) Forgive(woken - wake_);
  }
}

Watchdog::Clock::time_point Watchdog::Check(Clock::time_point now) {
  Clock::time_point earliest = Clock::time_point::max();
  for (auto& [id, timer] : timers_) {
    if (timer.deadline > now) {
      earliest = std::min(earliest, timer.deadline);
      continue;
    }
    timer.deadline = Clock::time_point::max();
    timer.overdue = true;
    timer.on_overdue();
  }
  return earliest;
}

void Watchdog::Forgive(Clock::duration pause) {
  for (auto& [id, timer] : timers_) {
    if (timer.deadline != Clock::time_point::max()) timer.deadline += pause;
  }
}

}  // namespace craftfleet
