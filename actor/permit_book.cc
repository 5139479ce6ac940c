#include "actor/permit_book.h"

#include <algorithm>
#include <utility>

namespace craftfleet {

void PermitBook::SetTile(int tile) {
  MutexLock lock(&mu_);
  tile_ = tile;
}

void PermitBook::Add(const HeldPermit& permit) {
  MutexLock lock(&mu_);
  if (!active_.insert(permit).second) return;
  waiting_[LoopOf(permit.lane)].push_back(permit);
  changed_.NotifyAll();
}

std::vector<HeldPermit> PermitBook::Take(int loop) {
  MutexLock lock(&mu_);
  changed_.Wait(&mu_, [&]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return closed_ || !waiting_[loop].empty(); });
  if (closed_) return {};
  return std::exchange(waiting_[loop], {});
}

void PermitBook::Release(const HeldPermit& permit) {
  MutexLock lock(&mu_);
  active_.erase(permit);
  std::vector<HeldPermit>& waiting = waiting_[LoopOf(permit.lane)];
  waiting.erase(std::remove(waiting.begin(), waiting.end(), permit), waiting.end());
}

std::vector<HeldPermit> PermitBook::Active() const {
  MutexLock lock(&mu_);
  return {active_.begin(), active_.end()};
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
