#include "envserver/game_threads.h"

#include <utility>

namespace craftfleet {

GameThreads::GameThreads(int threads) {
  threads_.reserve(threads);
  for (int i = 0; i < threads; ++i) threads_.emplace_back([this] { Run(); });
}

GameThreads::~GameThreads() {
  {
    const MutexLock lock(&mu_);
    stopping_ = true;
    while (!idle_.empty()) CallIdle();
  }
  for (std::thread& thread : threads_) thread.join();
}

void GameThreads::Add(std::function<void()> job) {
  const MutexLock lock(&mu_);
  jobs_.push_back(std::move(job));
  waiting_ = jobs_.size();
  if (!idle_.empty()) CallIdle();
}

void GameThreads::CallIdle() {
  idle_.back()->is_called = true;
  idle_.back()->called.NotifyAll();
  idle_.pop_back();
}

void GameThreads::Run() {
  for (std::function<void()> job = Take(); job != nullptr; job = Take()) job();
}

std::function<void()> GameThreads::Take() {
  const MutexLock lock(&mu_);
  while (jobs_.empty() && !stopping_) {
    Idle idle;
    idle_.push_back(&idle);
    idle.called.Wait(&mu_, [&] { return idle.is_called; });
  }
  if (jobs_.empty()) return nullptr;
  std::function<void()> job = std::move(jobs_.front());
  jobs_.pop_front();
  waiting_ = jobs_.size();
  return job;
}

}  // namespace craftfleet
