// Pictures of a game in any size, which do not affect the game.

#pragma once

#include <memory>
#include <string>

#include <absl/status/statusor.h>

#include "common/config/env_name.h"
#include "deploy/cli/screen/screen.h"
#include "envserver/game.h"
#include "envserver/render/textures.h"

namespace craftfleet {

// A renderer for square pictures of `size` pixels of games on `env` with episodes of `length` steps.
//   Errors as Renderer::Create.
absl::StatusOr<std::shared_ptr<const Renderer>> SquareRenderer(const Textures& textures, const EnvName& env, int length,
                                                               int size);

// The size of the largest square picture in `room`, in pixels: at most 1,024, whole cells of `view` cells a side.
int PictureSize(const PictureRoom& room, int view);

// Thread-compatible.
class GamePictures {
 public:
  GamePictures(std::shared_ptr<const Textures> textures, EnvName env)
      : textures_(std::move(textures)), env_(std::move(env)) {}

  // The state of `game`, a game on the environment, for recordings, with a picture uint8[size,size,3]. `frame` is its
  // current frame.
  absl::StatusOr<Moment> Take(const Game& game, const std::string& frame, int size);

 private:
  const std::shared_ptr<const Textures> textures_;
  const EnvName env_;
  int size_ = 0;
  std::shared_ptr<const Renderer> renderer_;  // of size_
};

}  // namespace craftfleet
