// A game that a test plays itself, without a server.

#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include <absl/types/span.h>

#include "common/io/paths.h"
#include "envserver/game.h"

namespace craftfleet {

// Draws the project's textures, for episodes of `length` steps.
inline std::shared_ptr<const Renderer> MakeRenderer(int length = 10000, int size = 64) {
  WorldOptions world;
  world.length = length;
  RenderOptions picture;
  picture.width = size;
  picture.height = size;
  return *Renderer::Create(**Textures::Load(*DefaultTextureDir()), world, picture);
}

// A game with its picture, and what StepAndAutoReset appends.
struct PlayedGame {
  PlayedGame(std::shared_ptr<const Renderer> renderer, int64_t seed)
      : frame(renderer->frame_bytes(), '\0'), game(*Game::Create(std::move(renderer), seed, Bytes())) {}

  absl::Span<uint8_t> Bytes() { return absl::MakeSpan(reinterpret_cast<uint8_t*>(frame.data()), frame.size()); }
  Game::PlayedStep Step(Action action) { return game.StepAndAutoReset(action, Bytes(), &last_frames); }

  std::string frame;
  std::string last_frames;
  Game game;
};

}  // namespace craftfleet
