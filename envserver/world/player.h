// The player's part of a step. Source: RULES.md, section 6.

#pragma once

#include "common/base/crafter.h"
#include "envserver/world/state.h"

namespace craftfleet {

// Carries out `action`, then updates needs, health and sleep.
void UpdatePlayer(Action action, WorldState* state);

}  // namespace craftfleet
