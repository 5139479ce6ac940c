#include "actor/permit_book.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace craftfleet {

void PermitBook::SetTile(int tile) {
  MutexLock lock(&mu_);
  tile_ = tile;
}

void PermitBook::Add(const HeldPermit& permit) {
  MutexLock lock(&mu_);
  if (!active_.try_emplace(permit, 0).second) return;
  waiting_[LoopOf(permit.lane)].push_back(permit);
  changed_.NotifyAll();
}

std::vector<HeldPermit> PermitBook::Take(int loop) {
  MutexLock lock(&mu_);
  changed_.Wait(&mu_, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return closed_ || !waiting_[loop].empty(); });
  if (closed_) return {};
  for (const HeldPermit& done : playing_[loop]) {
    if (const auto entry = active_.find(done); entry != active_.end()) entry->second = steps_[loop];
  }
  playing_[loop] = {waiting_[loop].begin(), waiting_[loop].end()};
  steps_[loop] = 0;
  return std::exchange(waiting_[loop], {});
}

void PermitBook::Release(const HeldPermit& permit) {
  MutexLock lock(&mu_);
  ReleaseLocked(permit);
}

void PermitBook::ReleaseLocked(const HeldPermit& permit) {
  active_.erase(permit);
  playing_[LoopOf(permit.lane)].erase(permit);
  std::vector<HeldPermit>& waiting = waiting_[LoopOf(permit.lane)];
  waiting.erase(std::remove(waiting.begin(), waiting.end(), permit), waiting.end());
}

std::vector<HeldPermit> PermitBook::Active() const {
  MutexLock lock(&mu_);
  std::vector<HeldPermit> permits;
  for (const auto& [permit, steps] : active_) permits.push_back(permit);
  return permits;
}

std::vector<PermitProgress> PermitBook::Progress() const {
  MutexLock lock(&mu_);
  std::vector<PermitProgress> progress;
  for (const auto& [permit, steps] : active_) {
    const size_t loop = LoopOf(permit.lane);
    progress.push_back({permit, playing_[loop].count(permit) > 0 ? steps_[loop] : steps});
  }
  return progress;
}

void PermitBook::SetSteps(int loop, int64_t steps) {
  MutexLock lock(&mu_);
  steps_[loop] = steps;
}

void PermitBook::Fail(const HeldPermit& permit, const std::string& reason) {
  MutexLock lock(&mu_);
  ReleaseLocked(permit);
  failed_[permit.lane] = {permit, reason};
}

std::vector<FailedPermit> PermitBook::Failures(int64_t epoch) {
  MutexLock lock(&mu_);
  std::vector<FailedPermit> failures;
  for (auto entry = failed_.begin(); entry != failed_.end();) {
    const FailedPermit& failure = entry->second;
    const bool counts = failure.permit.epoch == epoch;
    if (counts) failures.push_back(failure);
    entry = counts ? std::next(entry) : failed_.erase(entry);
  }
  return failures;
}

void PermitBook::Told(const std::vector<FailedPermit>& failures) {
  MutexLock lock(&mu_);
  for (const FailedPermit& told : failures) {
    const auto entry = failed_.find(told.permit.lane);
    if (entry != failed_.end() && entry->second.permit == told.permit) failed_.erase(entry);
  }
}

void PermitBook::DropWaiting() {
  MutexLock lock(&mu_);
  for (std::vector<HeldPermit>& permits : waiting_) {
    for (const HeldPermit& permit : permits) active_.erase(permit);
    permits.clear();
  }
}

void PermitBook::WaitForClose(absl::Duration timeout) {
  MutexLock lock(&mu_);
  changed_.WaitFor(&mu_, timeout, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return closed_; });
}

size_t PermitBook::LoopOf(int lane) const { return (lane / tile_) % waiting_.size(); }

void PermitBook::Close() {
  MutexLock lock(&mu_);
  closed_ = true;
  changed_.NotifyAll();
}

}  // namespace craftfleet
