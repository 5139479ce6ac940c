// What this process takes of its machine.

#ifndef CRAFTFLEET_COMMON_PROCESS_USAGE_H_
#define CRAFTFLEET_COMMON_PROCESS_USAGE_H_

#include <cstdint>

namespace craftfleet {

struct ProcessUsage {
  double cpu_seconds = 0;  // user and system, all threads
  int64_t open_files = 0;  // descriptors, sockets included
};

// Numbers that the system does not tell are 0. Thread-safe.
ProcessUsage ReadProcessUsage();

// How many more files the process' limit lets it open (ulimit -n). Thread-safe.
int64_t FilesLeft();

// The process' resident memory; 0 where the system does not tell. Thread-safe.
int64_t ResidentMemoryBytes();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_USAGE_H_
