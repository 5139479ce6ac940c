// The threads of the test's process.

#ifndef CRAFTFLEET_TESTS_FAKES_THREADS_H_
#define CRAFTFLEET_TESTS_FAKES_THREADS_H_

#include <filesystem>

namespace craftfleet {

inline int CountThreads() {
  int threads = 0;
  for ([[maybe_unused]] const auto& thread : std::filesystem::directory_iterator("/proc/self/task")) ++threads;
  return threads;
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_FAKES_THREADS_H_
