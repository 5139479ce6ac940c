#include "common/base/worker_pool.h"

namespace craftfleet {

WorkerPool::WorkerPool(int threads, const std::function<void()>& on_start) {
  try {
    for (int i = 1; i < threads; ++i) {
      threads_.emplace_back([this, on_start] {
        on_start();
        WorkUntilStopped();
      });
    }
  } catch (...) {
    Stop();
    throw;
  }
}

WorkerPool::~WorkerPool() { Stop(); }

void WorkerPool::Stop() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    changed_.NotifyAll();
  }
  for (std::thread& thread : threads_) thread.join();
}

void WorkerPool::Run(int count, const std::function<void(int)>& part) {
  MutexLock lock(&mu_);
  part_ = &part;
  next_ = 0;
  count_ = unfinished_ = count;
  changed_.NotifyAll();
  TakeParts();
  changed_.Wait(&mu_, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return unfinished_ == 0; });
  part_ = nullptr;
}

void WorkerPool::WorkUntilStopped() {
  MutexLock lock(&mu_);
  while (true) {
    changed_.Wait(&mu_, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return stopping_ || next_ < count_; });
    if (stopping_) return;
    TakeParts();
  }
}

void WorkerPool::TakeParts() {
  while (next_ < count_) {
    const std::function<void(int)>& part = *part_;
    const int index = next_++;
    mu_.Unlock();
    part(index);
    mu_.Lock();
    if (--unfinished_ == 0) changed_.NotifyAll();
  }
}

}  // namespace craftfleet
