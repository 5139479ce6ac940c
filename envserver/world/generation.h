// How a new world comes about. Source: Crafter's rules, "World generation"; determinism page, section 6; CrafterOOD
// page.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_GENERATION_H_
#define CRAFTFLEET_ENVSERVER_WORLD_GENERATION_H_

#include "envserver/world/state.h"

namespace craftfleet {

// Fills a cleared board on which only the player stands. Draws the noise's seed first.
void GenerateWorld(WorldState* state);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_GENERATION_H_
