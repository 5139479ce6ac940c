// Adds and removes creatures chunk by chunk, every tenth step.
// Source: RULES.md, section 8.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_BALANCE_H_
#define CRAFTFLEET_ENVSERVER_WORLD_BALANCE_H_

#include "envserver/world/state.h"

namespace craftfleet {

// Balances each known chunk once; the caller does so in every tenth step.
void BalanceChunks(WorldState* state);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_BALANCE_H_
