// Asks the system for threads before a library that needs them does.

#pragma once

#include <mutex>
#include <thread>
#include <vector>

namespace craftfleet {

// Throws std::system_error, as std::thread does, unless `count` more threads can be started now. For libraries that
// hang or crash where the system refuses them a thread.
inline void NeedThreads(unsigned count) {
  std::mutex hold;  // until all have been started
  std::vector<std::thread> threads;
  const auto join = [&] {
    hold.unlock();
    for (std::thread& thread : threads) thread.join();
  };
  hold.lock();
  try {
    for (unsigned i = 0; i < count; ++i) {
      threads.emplace_back([&hold] { const std::lock_guard<std::mutex> wait(hold); });
    }
  } catch (...) {
    join();
    throw;
  }
  join();
}

}  // namespace craftfleet
