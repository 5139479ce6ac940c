// The largest game: an object on every cell.

#ifndef CRAFTFLEET_TESTS_ENVSERVER_FULL_GAME_H_
#define CRAFTFLEET_TESTS_ENVSERVER_FULL_GAME_H_

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "envserver/game.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {

// The snapshot of a new game with a plant on each free cell.
inline std::string FullSnapshot(std::shared_ptr<const Renderer> renderer) {
  std::vector<uint8_t> frame(renderer->frame_bytes());
  const Game game = *Game::Create(std::move(renderer), 1, absl::MakeSpan(frame));
  WorldEditor::FillWithPlants(const_cast<World*>(&game.world()));
  return game.Save();
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_ENVSERVER_FULL_GAME_H_
