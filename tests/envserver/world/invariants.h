// What must hold in a world whenever no step is under way.

#ifndef CRAFTFLEET_TESTS_ENVSERVER_WORLD_INVARIANTS_H_
#define CRAFTFLEET_TESTS_ENVSERVER_WORLD_INVARIANTS_H_

#include <string>

#include "envserver/world/world.h"

namespace craftfleet {

// Empty, or what is wrong.
std::string BrokenInvariant(const World& world);

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_ENVSERVER_WORLD_INVARIANTS_H_
