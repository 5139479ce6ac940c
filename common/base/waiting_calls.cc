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
    Wake();
  }
  if (thread_.joinable()) thread_.join();
  std::vector<Call> left;
  {
    const MutexLock lock(&mu_);
    left.swap(calls_);
  }
  for (const Call& call : left) call.attempt(/*last=*/true);
}

void WaitingCalls::Add(Attempt attempt, absl::Duration wait, absl::string_view caller) {
  Call call = {std::move(attempt), SteadyNow() + wait, BucketOf(caller)};
  {
    const MutexLock lock(&mu_);
    call.tried = Changes(call.bucket);
  }
  // Once it has answered, nothing of this object may be used: its owner may only wait for answers.
  if (!call.attempt(/*last=*/wait <= absl::ZeroDuration())) Keep(std::move(call));
}

void WaitingCalls::Retry() {
  const MutexLock lock(&mu_);
  ++rounds_;
  Wake();
}

void WaitingCalls::Retry(absl::string_view caller) {
  const MutexLock lock(&mu_);
  ++retries_[BucketOf(caller)];
  Wake();
}

size_t WaitingCalls::size() const {
  const MutexLock lock(&mu_);
  return calls_.size();
}

void WaitingCalls::Wake() {
  is_awake_ = true;
  changed_.NotifyAll();
}

void WaitingCalls::Keep(Call call) {
  const MutexLock lock(&mu_);
  if (call.deadline < next_look_ || call.tried != Changes(call.bucket)) Wake();
  calls_.push_back(std::move(call));
  if (!thread_.joinable()) thread_ = std::thread([this] { Run(); });
}

void WaitingCalls::Run() {
  for (std::vector<Call> due = AwaitDue(); !due.empty(); due = AwaitDue()) {
    for (Call& call : due) {
      {
        const MutexLock lock(&mu_);
        call.tried = Changes(call.bucket);
      }
      if (!call.attempt(/*last=*/SteadyNow() >= call.deadline)) Keep(std::move(call));
    }
  }
}

std::vector<WaitingCalls::Call> WaitingCalls::AwaitDue() {
  std::vector<Call> due;
  const MutexLock lock(&mu_);
  while (!stopping_) {
    is_awake_ = false;
    const absl::Time now = SteadyNow();
    const auto waits = [&](const Call& call) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
      return call.deadline > now && call.tried == Changes(call.bucket);
    };
    const auto first_due = std::stable_partition(calls_.begin(), calls_.end(), waits);
    std::move(first_due, calls_.end(), std::back_inserter(due));
    calls_.erase(first_due, calls_.end());
    if (!due.empty()) return due;
    next_look_ = absl::InfiniteFuture();
    for (const Call& call : calls_) next_look_ = std::min(next_look_, call.deadline);
    changed_.WaitFor(&mu_, next_look_ - now, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return is_awake_; });
  }
  return due;
}

}  // namespace craftfleet
