// The unique name of a worker.

#ifndef CRAFTFLEET_COMMON_PROCESS_WORKER_NAME_H_
#define CRAFTFLEET_COMMON_PROCESS_WORKER_NAME_H_

#include <string>

namespace craftfleet {

// "host-1234-89abcdef": host, process id and a random number, which differs at each call, so that a restarted worker is
// not mistaken for the previous one.
std::string UniqueWorkerName();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_WORKER_NAME_H_
