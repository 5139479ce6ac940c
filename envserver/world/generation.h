// Generates the world of a new episode. Source: RULES.md, sections 3 and 14.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_GENERATION_H_
#define CRAFTFLEET_ENVSERVER_WORLD_GENERATION_H_

#include "envserver/world/state.h"

namespace craftfleet {

// Fills a cleared board that contains only the player. Draws the noise's seed first.
void GenerateWorld(WorldState* state);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_GENERATION_H_
