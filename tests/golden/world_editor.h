// Sets up situations in a world and accesses its private state: for tests only.

#pragma once

#include <absl/status/status.h>
#include <nlohmann/json.hpp>

#include "envserver/world/state.h"
#include "envserver/world/world.h"

namespace craftfleet {

class WorldEditor {
 public:
  static const WorldState& State(const World& world) { return world.state_; }
  static WorldState& State(World* world) { return world->state_; }

  // Applies a `set` line of a scenario trace; draws nothing. Source: the README in CRAFTFLEET_GOLDEN_DIR, "Scenario
  // traces".
  //   InvalidArgument: a position outside the world, a missing object, or an occupied cell.
  // Throws nlohmann::json::exception if a value has the wrong shape.
  static absl::Status Apply(const nlohmann::json& edit, World* world);

  // Puts a plant on each free cell: the most objects that a world can have.
  static void FillWithPlants(World* world);
};

}  // namespace craftfleet
