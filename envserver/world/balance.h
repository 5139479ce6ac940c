// Adds and removes creatures chunk by chunk, every tenth step.
//
// Known chunks are visited in the order in which they became known; in each, zombies, then skeletons, then cows:
//
//   creature  on     spawn distance  despawn distance  spawn chance  despawn chance  low                    high
//   zombie    grass  6               0                 0.3           0.4             z, but 0 below 50 cells  z
//   skeleton  path   7               7                 0.1           0.1             1, but 0 below 6 cells   2
//   cow       grass  5               5                 0.01          0.1             1, but 0 below 30 cells  c
//
// z = trunc(3.5 - 3 * daylight), c = trunc(1.5 + daylight); cells are the chunk's of the material in the second column.
// If the chunk has fewer of the creatures than `low`, and U() < spawn chance: R(cells) picks a cell among those, x in
// the outer loop. The creature is added if the cell holds no object and its distance to the player is at least the
// spawn distance. Otherwise, if it has more than `high`, and U() < despawn chance: R(creatures) picks one in the order
// in which they entered the chunk. It is removed if its distance to the player is at least the despawn distance.

#pragma once

#include "envserver/world/state.h"

namespace craftfleet {

// Balances each known chunk once; the caller does so in every tenth step.
void BalanceChunks(WorldState* state);

}  // namespace craftfleet
