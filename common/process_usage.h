// What this process takes of its machine.

#ifndef CRAFTFLEET_COMMON_PROCESS_USAGE_H_
#define CRAFTFLEET_COMMON_PROCESS_USAGE_H_

#include <cstdint>

namespace craftfleet {

struct ProcessUsage {
  double cpu_seconds = 0;    // user and system, all threads
  int64_t memory_bytes = 0;  // resident
  int64_t open_files = 0;    // descriptors, sockets included
};

// Numbers that the system does not tell are 0. Thread-safe.
ProcessUsage ReadProcessUsage();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_USAGE_H_
