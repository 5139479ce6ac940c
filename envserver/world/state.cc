#include "envserver/world/state.h"

namespace craftfleet {

WorldState::WorldState(const WorldOptions& world_options)
    : options(world_options), board(world_options.width, world_options.height) {}

}  // namespace craftfleet
