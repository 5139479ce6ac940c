// One game as Python sees it: unlike envserver/game.h it may be drawn at any size, and worlds of any size can be saved.

#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/base/crafter.h"
#include "engine/setup.h"
#include "envserver/world/random_stream.h"
#include "envserver/world/world.h"

namespace craftfleet {

// Every `frame` is uint8[height][width][3] of its renderer's frame_bytes(). Thread-compatible: one thread at a time.
class Lane {
 public:
  // The game begins with the first Reset().
  Lane(std::shared_ptr<const Setup> setup, int64_t seed) : setup_(std::move(setup)), seed_(seed) {}

  // Starts the next episode; the first one is number 1.
  void Reset(absl::Span<uint8_t> frame);
  // After Reset(). The caller resets after an end.
  StepOutcome Step(Action action, absl::Span<uint8_t> frame);

  bool started() const { return world_.has_value(); }
  // After Reset().
  const World& world() const { return *world_; }
  const std::shared_ptr<const Setup>& setup() const { return setup_; }
  int64_t seed() const { return seed_; }

  // Draws this moment as Reset() or Step() drew it: by night with the same noise. The game does not change.
  void Redraw(const Renderer& renderer, absl::Span<uint8_t> frame) const;
  // Draws this moment as Crafter's env.render() does: by night, noise is taken from the game's random stream.
  void DrawFromStream(const Renderer& renderer, absl::Span<uint8_t> frame);

  // The whole game as bytes: the stream as it was before the last picture (words uint32[624], position uint16, crc32c),
  // then World::Save().
  std::string Save() const;
  // Restores the state at Save(), of this game or of another with the same setup. On failure the game is unchanged.
  //   InvalidArgument: the snapshot of another setup or version.   DataLoss: cut or damaged bytes.
  absl::Status Restore(absl::string_view snapshot);

 private:
  void Draw(absl::Span<uint8_t> frame);

  std::shared_ptr<const Setup> setup_;
  int64_t seed_;
  std::optional<World> world_;
  RandomStream before_picture_;
};

}  // namespace craftfleet
