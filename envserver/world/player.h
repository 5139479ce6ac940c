// The player's part of a step. Source: Crafter's rules, "Player update"; determinism page, section 2.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_PLAYER_H_
#define CRAFTFLEET_ENVSERVER_WORLD_PLAYER_H_

#include "common/crafter.h"
#include "envserver/world/state.h"

namespace craftfleet {

void UpdatePlayer(Action action, WorldState* state);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_PLAYER_H_
