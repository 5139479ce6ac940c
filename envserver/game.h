// One game of Crafter as an agent sees it: a world and its pictures.

#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/base/crafter.h"
#include "common/base/types.h"
#include "common/io/snapshot_envelope.h"
#include "envserver/render/renderer.h"
#include "envserver/render/scene_record.h"
#include "envserver/world/random_stream.h"
#include "envserver/world/world.h"

namespace craftfleet {

// The bytes of a picture that is kept in a string.
inline absl::Span<uint8_t> FrameBytes(std::string* frame) {
  return absl::MakeSpan(reinterpret_cast<uint8_t*>(frame->data()), frame->size());
}

// Every `frame` is uint8[height][width][3] of renderer->frame_bytes(). Thread-compatible: one thread at a time; games
// on different threads may share a renderer.
class Game {
 public:
  // The outcome of a step, and the episode if the step ended it.
  struct PlayedStep {
    StepOutcome outcome;
    std::optional<Episode> episode;  // its `step` is left 0
  };

  // A new game with the renderer's world options, at the beginning of `episode` (1 or more). Writes its first picture
  // to `frame`. A late episode costs no more than an early one.
  static absl::StatusOr<Game> Create(std::shared_ptr<const Renderer> renderer, int64_t seed, absl::Span<uint8_t> frame,
                                     int64_t episode = 1);

  // Starts the next episode.
  void Reset(absl::Span<uint8_t> frame);
  // As Crafter's env.step: the caller resets after an end.
  StepOutcome Step(Action action, absl::Span<uint8_t> frame);
  // One step. If it ends the episode, the next one starts and its first picture goes to `frame`. The last picture of a
  // truncated episode is appended to `last_frames`; that of a death is not needed. With `on_step`, the picture after
  // the step is always drawn, and `on_step` is called while `frame` holds it.
  PlayedStep StepAndAutoReset(Action action, absl::Span<uint8_t> frame, std::string* last_frames,
                              const std::function<void()>& on_step = nullptr);

  // The same without drawing: appends the record of each picture (scene_record.h) to `frames`, or to `last_frames`.
  // With `anew`, the records from this step on can be read without those before.
  PlayedStep StepAndRecord(Action action, bool anew, std::string* frames, std::string* last_frames);
  // Appends the record of the current picture. It can be read without those before.
  void Record(std::string* frames);

  // The whole game as bytes (World::Save) in an envelope (common/io/snapshot_envelope.h). The current picture is not
  // stored but can be drawn again.
  std::string Save() const;
  // Restores the state at Save() and writes the picture of that moment to `frame`. On failure game and frame are
  // unchanged.
  //   InvalidArgument: too large, or no envelope of such a game.   DataLoss: of a game that has ended.   Others as
  //   World::Restore().
  absl::Status Restore(absl::string_view snapshot, absl::Span<uint8_t> frame);

  // The game's state for videos and episode files, with its current `frame` and the picture that `larger` draws; null:
  // none. The game is not affected: by night, the picture's noise comes from a copy of its stream.
  Moment TakeMoment(absl::Span<const uint8_t> frame, const Renderer* larger) const;

  const World& world() const { return world_; }
  // The world's stream before the current picture was drawn; with it the same picture can be drawn again at night.
  const RandomStream& before_picture() const {
    return Renderer::DrawsNoise(world_) ? before_picture_ : world_.random();
  }

 private:
  Game(std::shared_ptr<const Renderer> renderer, World world)
      : renderer_(std::move(renderer)), world_(std::move(world)) {}

  void Draw(absl::Span<uint8_t> frame);
  // Instead of Draw(): takes the draws of a picture from the stream.
  void PassPicture();
  // Appends the record of the current picture.
  void AppendRecord(std::string* frames);
  // The environment digest in envelopes of this game.
  uint64_t env_digest() const { return EnvDigest(world_.options().name, world_.options().length); }
  // The current episode, which has ended; its `step` is left 0.
  Episode EndedEpisode() const;

  std::shared_ptr<const Renderer> renderer_;
  World world_;
  RandomStream before_picture_;  // of a picture with noise; others leave the stream as it is
  SceneWriter scene_writer_;
};

}  // namespace craftfleet
