// Who a worker is.

#ifndef CRAFTFLEET_COMMON_WORKER_NAME_H_
#define CRAFTFLEET_COMMON_WORKER_NAME_H_

#include <string>

namespace craftfleet {

// "host-1234-89abcdef": host, process and a random incarnation. A new one at each call, so that a restarted worker is
// never taken for its former self.
std::string UniqueWorkerName();

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_WORKER_NAME_H_
