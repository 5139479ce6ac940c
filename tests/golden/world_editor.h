// Stages situations in a world and looks at what its public face does not show: for tests only.

#ifndef CRAFTFLEET_TESTS_GOLDEN_WORLD_EDITOR_H_
#define CRAFTFLEET_TESTS_GOLDEN_WORLD_EDITOR_H_

#include <absl/status/status.h>
#include <nlohmann/json.hpp>

#include "envserver/world/state.h"
#include "envserver/world/world.h"

namespace craftfleet {

class WorldEditor {
 public:
  static const WorldState& State(const World& world) { return world.state_; }
  static WorldState& State(World* world) { return world->state_; }

  // Applies a `set` line of a scenario trace; draws nothing. Source: README of the golden data, "Scenario traces".
  //   InvalidArgument: a position outside the world, no object where one is meant, one where none may be.
  // Throws nlohmann::json::exception where a value has the wrong shape.
  static absl::Status Apply(const nlohmann::json& edit, World* world);
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_GOLDEN_WORLD_EDITOR_H_
