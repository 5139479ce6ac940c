// The player's part of a step. Source: RULES.md, section 6.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_PLAYER_H_
#define CRAFTFLEET_ENVSERVER_WORLD_PLAYER_H_

#include "common/base/crafter.h"
#include "envserver/world/state.h"

namespace craftfleet {

// Carries out `action`, then updates needs, health and sleep.
void UpdatePlayer(Action action, WorldState* state);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_PLAYER_H_
