#include "actor/permit_tracker.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace craftfleet {

void PermitTracker::Distribute(int tile, int loops) {
  MutexLock lock(&mu_);
  tile_ = tile;
  loops_ = loops;
}

void PermitTracker::Add(const HeldPermit& permit) {
  MutexLock lock(&mu_);
  if (!active_.insert(permit).second) return;
  waiting_[LoopOf(permit.lane)].push_back(permit);
  changed_.NotifyAll();
}

std::vector<HeldPermit> PermitTracker::Take(int loop, absl::Duration timeout) {
  MutexLock lock(&mu_);
  changed_.WaitFor(&mu_, timeout,
                   [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return closed_ || !waiting_[loop].empty(); });
  if (closed_ || waiting_[loop].empty()) return {};
  const auto age = [](const HeldPermit& permit) { return std::make_pair(permit.epoch, permit.policy_version); };
  std::vector<HeldPermit>& waiting = waiting_[loop];
  const auto oldest = age(*std::min_element(waiting.begin(), waiting.end(),
                                            [&](const HeldPermit& a, const HeldPermit& b) { return age(a) < age(b); }));
  const auto rest = std::stable_partition(waiting.begin(), waiting.end(),
                                          [&](const HeldPermit& permit) { return age(permit) == oldest; });
  std::vector<HeldPermit> taken(waiting.begin(), rest);
  waiting.erase(waiting.begin(), rest);
  return taken;
}

void PermitTracker::Release(const HeldPermit& permit) {
  MutexLock lock(&mu_);
  ReleaseLocked(permit);
}

void PermitTracker::ReleaseLocked(const HeldPermit& permit) {
  active_.erase(permit);
  std::vector<HeldPermit>& waiting = waiting_[LoopOf(permit.lane)];
  waiting.erase(std::remove(waiting.begin(), waiting.end(), permit), waiting.end());
}

std::vector<HeldPermit> PermitTracker::Active() const {
  MutexLock lock(&mu_);
  return {active_.begin(), active_.end()};
}

void PermitTracker::Fail(const HeldPermit& permit, const std::string& reason) {
  MutexLock lock(&mu_);
  ReleaseLocked(permit);
  HeldPermit& failed = failed_[permit.lane];
  failed = permit;
  failed.failure = reason;
}

std::vector<HeldPermit> PermitTracker::Failures(int64_t epoch) {
  MutexLock lock(&mu_);
  std::vector<HeldPermit> failures;
  for (auto entry = failed_.begin(); entry != failed_.end();) {
    const HeldPermit& failure = entry->second;
    const bool is_current = failure.epoch == epoch;
    if (is_current) failures.push_back(failure);
    entry = is_current ? std::next(entry) : failed_.erase(entry);
  }
  return failures;
}

void PermitTracker::SetReported(const std::vector<HeldPermit>& failures) {
  MutexLock lock(&mu_);
  for (const HeldPermit& reported : failures) {
    const auto entry = failed_.find(reported.lane);
    if (entry != failed_.end() && entry->second == reported) failed_.erase(entry);
  }
}

void PermitTracker::DropWaiting() {
  MutexLock lock(&mu_);
  for (std::vector<HeldPermit>& permits : waiting_) {
    for (const HeldPermit& permit : permits) active_.erase(permit);
    permits.clear();
  }
}

void PermitTracker::WaitForClose(absl::Duration timeout) {
  MutexLock lock(&mu_);
  changed_.WaitFor(&mu_, timeout, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return closed_; });
}

size_t PermitTracker::LoopOf(int lane) const { return (lane / tile_) % loops_; }

void PermitTracker::Close() {
  MutexLock lock(&mu_);
  closed_ = true;
  changed_.NotifyAll();
}

bool PermitTracker::closed() const {
  MutexLock lock(&mu_);
  return closed_;
}

}  // namespace craftfleet
