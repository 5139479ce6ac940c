// Creatures that come and go: every tenth step, chunk by chunk.
// Source: Crafter's rules, "Chunk balance"; determinism page, section 1.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_BALANCE_H_
#define CRAFTFLEET_ENVSERVER_WORLD_BALANCE_H_

#include "envserver/world/state.h"

namespace craftfleet {

void BalanceChunks(WorldState* state);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_BALANCE_H_
