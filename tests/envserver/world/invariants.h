// The invariants of a world between steps.

#ifndef CRAFTFLEET_TESTS_ENVSERVER_WORLD_INVARIANTS_H_
#define CRAFTFLEET_TESTS_ENVSERVER_WORLD_INVARIANTS_H_

#include <string>

#include "envserver/world/world.h"

namespace craftfleet {

// The first broken invariant, or empty.
std::string BrokenInvariant(const World& world);

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_ENVSERVER_WORLD_INVARIANTS_H_
