#include "common/base/waiting_calls.h"

#include <algorithm>

#include "common/base/clock.h"

namespace craftfleet {

WaitingCalls::~WaitingCalls() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    changed_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
  std::vector<Call> left;
  {
    const MutexLock lock(&mu_);
    while (!by_deadline_.empty()) left.push_back(Take(by_deadline_.begin()->second));
  }
  for (const Call& call : left) call.attempt(/*last=*/true);
}

void WaitingCalls::Add(Attempt attempt, absl::Duration wait, absl::string_view caller) {
  const Moment before = LockedNow(caller);
  // Once it has answered, nothing of this object may be used: its owner may only wait for answers.
  if (attempt(/*last=*/wait <= absl::ZeroDuration())) return;
  Keep({std::move(attempt), SteadyNow() + wait, std::string(caller), before});
}

void WaitingCalls::Retry() {
  const MutexLock lock(&mu_);
  ++round_;
  changed_.NotifyAll();
}

void WaitingCalls::Retry(absl::string_view caller) {
  const MutexLock lock(&mu_);
  ++retries_[BucketOf(caller)];
  const auto [begin, end] = by_caller_.equal_range(caller);
  for (auto entry = begin; entry != end; ++entry) retried_.insert(entry->second);
  if (begin != end) changed_.NotifyAll();
}

size_t WaitingCalls::size() const {
  const MutexLock lock(&mu_);
  return calls_.size();
}

WaitingCalls::Moment WaitingCalls::Now(absl::string_view caller) const { return {round_, retries_[BucketOf(caller)]}; }

WaitingCalls::Moment WaitingCalls::LockedNow(absl::string_view caller) const {
  const MutexLock lock(&mu_);
  return Now(caller);
}

void WaitingCalls::Keep(Call call) {
  const MutexLock lock(&mu_);
  const int64_t number = ++last_number_;
  const bool is_retried = call.tried != Now(call.caller);
  const bool is_first = by_deadline_.empty() || call.deadline < by_deadline_.begin()->first;
  if (is_retried) retried_.insert(number);
  by_deadline_.emplace(call.deadline, number);
  by_round_.emplace(call.tried.round, number);
  if (!call.caller.empty()) by_caller_.emplace(call.caller, number);
  calls_.emplace(number, std::move(call));
  if (!thread_.joinable()) thread_ = std::thread([this] { Run(); });
  if (is_first || is_retried) changed_.NotifyAll();
}

WaitingCalls::Call WaitingCalls::Take(int64_t number) {
  const auto entry = calls_.find(number);
  Call call = std::move(entry->second);
  calls_.erase(entry);
  by_deadline_.erase({call.deadline, number});
  by_round_.erase({call.tried.round, number});
  retried_.erase(number);
  const auto [begin, end] = by_caller_.equal_range(call.caller);
  const auto known = std::find_if(begin, end, [number](const auto& other) { return other.second == number; });
  if (known != end) by_caller_.erase(known);
  return call;
}

void WaitingCalls::Run() {
  for (std::vector<Call> due = AwaitDue(); !due.empty(); due = AwaitDue()) {
    for (Call& call : due) {
      call.tried = LockedNow(call.caller);
      if (!call.attempt(/*last=*/SteadyNow() >= call.deadline)) Keep(std::move(call));
    }
  }
}

int64_t WaitingCalls::NextDue(absl::Time now) const {
  if (!retried_.empty()) return *retried_.begin();
  if (!by_deadline_.empty() && by_deadline_.begin()->first <= now) return by_deadline_.begin()->second;
  if (!by_round_.empty() && by_round_.begin()->first != round_) return by_round_.begin()->second;
  return 0;
}

std::vector<WaitingCalls::Call> WaitingCalls::AwaitDue() {
  std::vector<Call> due;
  const MutexLock lock(&mu_);
  while (due.empty() && !stopping_) {
    const absl::Time until = by_deadline_.empty() ? absl::InfiniteFuture() : by_deadline_.begin()->first;
    const absl::Duration wait = std::max(until - SteadyNow(), absl::ZeroDuration());
    changed_.WaitFor(&mu_, wait, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
      return stopping_ || NextDue(SteadyNow()) != 0 || (!by_deadline_.empty() && by_deadline_.begin()->first < until);
    });
    const absl::Time now = SteadyNow();
    for (int64_t next = NextDue(now); next != 0 && due.size() < kAtOnce && !stopping_; next = NextDue(now)) {
      due.push_back(Take(next));
    }
  }
  return due;
}

}  // namespace craftfleet
