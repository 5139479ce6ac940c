// The unique name of a worker.

#pragma once

#include <string>

namespace craftfleet {

// "host-1234-89abcdef": host, process id and a random number, which differs at each call, so that a restarted worker is
// not mistaken for the previous one.
std::string UniqueWorkerName();

}  // namespace craftfleet
