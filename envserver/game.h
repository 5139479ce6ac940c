// One game of Crafter as an agent sees it: a world and its pictures.

#ifndef CRAFTFLEET_ENVSERVER_GAME_H_
#define CRAFTFLEET_ENVSERVER_GAME_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/optional.h>
#include <absl/types/span.h>

#include "common/crafter.h"
#include "common/snapshot_envelope.h"
#include "common/types.h"
#include "envserver/render/renderer.h"
#include "envserver/world/random_stream.h"
#include "envserver/world/world.h"

namespace craftfleet {

// Every `frame` is uint8[height][width][3] of renderer->frame_bytes(). Thread-compatible: one thread at a time; games
// on different threads may share a renderer.
class Game {
 public:
  // What a step gave, and the episode if it ended with it.
  struct PlayedStep {
    StepOutcome outcome;
    absl::optional<Episode> episode;  // its `step` is left 0
  };

  // A new game with the renderer's world options, at the beginning of `episode`, from 1, whose first picture goes to
  // `frame`. A late episode costs no more than an early one.
  static absl::StatusOr<Game> Create(std::shared_ptr<const Renderer> renderer, int64_t seed, absl::Span<uint8_t> frame,
                                     int64_t episode = 1);

  // Starts the next episode.
  void Reset(absl::Span<uint8_t> frame);
  // As Crafter's env.step: the caller resets after an end.
  StepOutcome Step(Action action, absl::Span<uint8_t> frame);
  // One step; after an end, the next episode is begun and its first picture goes to `frame`. The last picture of an
  // episode that was truncated is appended to `last_frames`; that of a death nobody needs. With `on_step` the picture
  // after the step is drawn in any case, and it is called when `frame` holds it.
  PlayedStep StepAndAutoReset(Action action, absl::Span<uint8_t> frame, std::string* last_frames,
                              const std::function<void()>& on_step = nullptr);

  // The whole game as bytes (World::Save) in an envelope (common/snapshot_envelope.h). The current picture is not
  // stored but can be drawn again.
  std::string Save() const;
  // Goes on where Save() was called, and writes the picture of that moment to `frame`. On failure game and frame are
  // unchanged.
  //   InvalidArgument: too large, or no envelope of such a game.   Others as World::Restore().
  absl::Status Restore(absl::string_view snapshot, absl::Span<uint8_t> frame);

  const World& world() const { return world_; }
  // The world's stream as it was before the current picture was drawn: draws the same night again.
  const RandomStream& before_picture() const { return before_picture_; }

 private:
  Game(std::shared_ptr<const Renderer> renderer, World world)
      : renderer_(std::move(renderer)), world_(std::move(world)) {}

  void Draw(absl::Span<uint8_t> frame);
  // What envelopes of this game are marked with.
  uint64_t env_digest() const { return EnvDigest(world_.options().name, world_.options().length); }
  // Of the current episode, when it has ended; its `step` is left 0.
  Episode EndedEpisode() const;

  std::shared_ptr<const Renderer> renderer_;
  World world_;
  RandomStream before_picture_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_GAME_H_
