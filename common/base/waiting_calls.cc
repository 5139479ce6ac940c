#include "common/base/waiting_calls.h"

#include <algorithm>
#include <iterator>
#include <utility>

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
    left.swap(waiting_);
  }
  for (const Call& call : left) call.attempt(/*last=*/true);
}

void WaitingCalls::Add(Attempt attempt, absl::Duration wait) {
  const int64_t before = changes();
  if (attempt(/*last=*/wait <= absl::ZeroDuration())) return;
  Keep({std::move(attempt), SteadyNow() + wait, before});
}

void WaitingCalls::Retry() {
  const MutexLock lock(&mu_);
  ++changes_;
  retry_ = true;
  changed_.NotifyAll();
}

size_t WaitingCalls::size() const {
  const MutexLock lock(&mu_);
  return waiting_.size();
}

int64_t WaitingCalls::changes() const {
  const MutexLock lock(&mu_);
  return changes_;
}

void WaitingCalls::Keep(Call call) {
  const MutexLock lock(&mu_);
  const bool is_first = call.deadline < first_deadline_;
  if (is_first) first_deadline_ = call.deadline;
  if (call.tried != changes_) retry_ = true;
  waiting_.push_back(std::move(call));
  if (!thread_.joinable()) thread_ = std::thread([this] { Run(); });
  if (is_first || retry_) changed_.NotifyAll();
}

void WaitingCalls::Run() {
  for (std::vector<Call> due = AwaitDue(); !due.empty(); due = AwaitDue()) {
    for (Call& call : due) {
      call.tried = changes();
      if (!call.attempt(/*last=*/SteadyNow() >= call.deadline)) Keep(std::move(call));
    }
  }
}

std::vector<WaitingCalls::Call> WaitingCalls::AwaitDue() {
  std::vector<Call> due;
  const MutexLock lock(&mu_);
  while (due.empty() && !stopping_) {
    const absl::Time until = first_deadline_;
    const absl::Duration wait = std::max(until - SteadyNow(), absl::ZeroDuration());
    changed_.WaitFor(&mu_, wait, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
      return stopping_ || retry_ || first_deadline_ < until;
    });
    if (!stopping_) due = TakeDue();
  }
  return due;
}

std::vector<WaitingCalls::Call> WaitingCalls::TakeDue() {
  const absl::Time now = SteadyNow();
  const int64_t changes = changes_;
  const auto first_due = std::partition(waiting_.begin(), waiting_.end(),
                                        [&](const Call& call) { return call.tried == changes && now < call.deadline; });
  std::vector<Call> due(std::make_move_iterator(first_due), std::make_move_iterator(waiting_.end()));
  waiting_.erase(first_due, waiting_.end());
  retry_ = false;
  first_deadline_ = absl::InfiniteFuture();
  for (const Call& call : waiting_) first_deadline_ = std::min(first_deadline_, call.deadline);
  return due;
}

}  // namespace craftfleet
