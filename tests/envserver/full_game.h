// The largest game: an object on every cell.

#pragma once

#include <memory>
#include <string>
#include <utility>

#include "tests/fakes/played_game.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {

// The snapshot of a new game with a plant on each free cell.
inline std::string FullSnapshot(std::shared_ptr<const Renderer> renderer) {
  PlayedGame played(std::move(renderer), 1);
  WorldEditor::FillWithPlants(const_cast<World*>(&played.game.world()));
  return played.game.Save();
}

}  // namespace craftfleet
