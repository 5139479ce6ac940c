// The threads of the test's process.

#pragma once

#include <filesystem>

namespace craftfleet {

inline int CountThreads() {
  int threads = 0;
  for ([[maybe_unused]] const auto& thread : std::filesystem::directory_iterator("/proc/self/task")) ++threads;
  return threads;
}

}  // namespace craftfleet
