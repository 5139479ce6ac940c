// Daylight by step. Source: RULES.md, section 9.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_DAYLIGHT_H_
#define CRAFTFLEET_ENVSERVER_WORLD_DAYLIGHT_H_

#include <cstdint>

namespace craftfleet {

// 0 (darkest) to 1 in the given step of an episode.
double Daylight(int64_t step);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_DAYLIGHT_H_
