// CPU time, open files and memory of this process.

#pragma once

#include <cstdint>

namespace craftfleet {

struct ProcessUsage {
  double cpu_seconds = 0;  // user and system, all threads
  int64_t open_files = 0;  // descriptors, sockets included
};

// Values that the system does not report are 0. Thread-safe.
ProcessUsage ReadProcessUsage();

// The number of files that the process can still open (ulimit -n). Thread-safe.
int64_t FilesLeft();
inline constexpr int64_t kKeptFiles = 128;  // of these, for all but connections; gRPC fails badly without any

// The process's resident memory; 0 if the system does not report it. Thread-safe.
int64_t ResidentMemoryBytes();

}  // namespace craftfleet
