// Creates and updates cows, zombies, skeletons, arrows and plants.
// Source: RULES.md, section 7.

#pragma once

#include "envserver/world/board.h"
#include "envserver/world/state.h"
#include "envserver/world/types.h"

namespace craftfleet {

// A new object of any type but the player, not yet on the board; no draws.
Object MakeObject(ObjectType type, Position position);

// Adds a cow, zombie or skeleton to a free cell.
void AddCreature(ObjectType type, Position position, Variant variant, Board* board);

// Any object but the player.
void UpdateObject(int index, WorldState* state);

}  // namespace craftfleet
