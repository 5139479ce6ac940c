#include "common/wire/hand_over.h"

#include <fcntl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <utility>

namespace craftfleet::wire {

HandOver::HandOver(std::vector<Handle> handles) : current_(handles.size()) {
  const MutexLock lock(&mu_);
  for (size_t i = 0; i < handles.size(); ++i) {
    threads_.emplace_back([this, handle = std::move(handles[i]), current = &current_[i]] { Run(handle, current); });
  }
}

HandOver::~HandOver() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    for (const int descriptor : waiting_) close(descriptor);
    waiting_.clear();
    changed_.NotifyAll();
    changed_.WaitFor(&mu_, absl::Seconds(1), [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return IsIdle(); });
  }
  ResetSlow(absl::ZeroDuration());
  for (std::thread& thread : threads_) thread.join();
}

bool HandOver::IsIdle() const {
  return std::all_of(current_.begin(), current_.end(), [](const Current& current) { return current.copy < 0; });
}

void HandOver::Add(int descriptor) {
  const MutexLock lock(&mu_);
  waiting_.push_back(descriptor);
  changed_.NotifyAll();
}

int HandOver::ResetSlow(absl::Duration limit) {
  const MutexLock lock(&mu_);
  const absl::Time now = clock_.Now();
  int count = 0;
  for (Current& current : current_) {
    if (current.copy < 0 || now - current.since < limit) continue;
    ResetConnection(current.copy);
    current.since = absl::InfiniteFuture();
    ++count;
  }
  return count;
}

void HandOver::Run(const Handle& handle, Current* current) {
  while (true) {
    int descriptor = -1;
    {
      const MutexLock lock(&mu_);
      changed_.Wait(&mu_, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || !waiting_.empty(); });
      if (waiting_.empty()) return;
      descriptor = waiting_.front();
      waiting_.pop_front();
      *current = {fcntl(descriptor, F_DUPFD_CLOEXEC, 0), clock_.Now()};
      if (current->copy < 0) {        // the process has no more descriptors
        ResetConnection(descriptor);  // so that the client does not wait for an answer
        close(descriptor);
        changed_.NotifyAll();
        continue;
      }
    }
    handle(descriptor);
    const MutexLock lock(&mu_);
    close(current->copy);
    current->copy = -1;
    changed_.NotifyAll();
  }
}

void ResetConnection(int socket) {
  sockaddr nowhere = {};
  nowhere.sa_family = AF_UNSPEC;
  if (connect(socket, &nowhere, sizeof(nowhere)) != 0) shutdown(socket, SHUT_RDWR);
}

}  // namespace craftfleet::wire
