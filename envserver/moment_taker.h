// Captures the state of a game at one moment, for videos and episode files.

#pragma once

#include <cstdint>
#include <memory>
#include <utility>

#include <absl/types/span.h>

#include "common/base/types.h"
#include "envserver/game.h"
#include "envserver/render/renderer.h"

namespace craftfleet {

// Immutable and thread-safe.
class MomentTaker {
 public:
  // `pictures` draws the larger pictures; null: none. It has the games' world options.
  explicit MomentTaker(std::shared_ptr<const Renderer> pictures) : pictures_(std::move(pictures)) {}

  // `frame` is the game's current one. The game is not affected: at night, the larger picture's noise
  // comes from a copy of its stream.
  Moment Take(const Game& game, absl::Span<const uint8_t> frame) const;

  int picture_bytes() const { return pictures_ == nullptr ? 0 : pictures_->frame_bytes(); }

 private:
  std::shared_ptr<const Renderer> pictures_;
};

}  // namespace craftfleet
