// One game of Crafter without its picture: the rules, bit for bit those of Crafter 1.8.3 (and of CrafterOOD).

#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/base/crafter.h"
#include "common/base/types.h"
#include "envserver/world/options.h"
#include "envserver/world/random_stream.h"
#include "envserver/world/state.h"
#include "envserver/world/types.h"

namespace craftfleet {

// The outcome of one step.
struct StepOutcome {
  double reward = 0;
  StepEnd end = StepEnd::kNone;
  uint32_t unlocked = 0;  // bit a: achievement a was unlocked for the first time in this episode
};

// A world is ready to play after Create(), at the beginning of an episode. After a step that ends the episode, call
// Reset(). Further steps are allowed; as in Crafter a dead player may then recover, and the episode goes on. A picture
// drawn at night takes draws from random(): the caller renders exactly once after Create() and after each Reset() and
// Step(), as Crafter does. Thread-compatible: one thread at a time. Source: RULES.md.
class World {
 public:
  // `episode` (1 or more) is the first one played; earlier ones are not generated.
  //   InvalidArgument: options that Validate() refuses.
  static absl::StatusOr<World> Create(const WorldOptions& options, int64_t seed, int64_t episode = 1);

  // Starts the next episode.
  void Reset();
  StepOutcome Step(Action action);

  const WorldOptions& options() const { return state_.options; }
  int64_t seed() const { return state_.seed; }
  int64_t episode() const { return state_.episode; }  // from 1
  int64_t step() const { return state_.step; }        // of this episode
  double daylight() const { return state_.daylight; }
  StepEnd end() const;                                             // how the episode has ended so far
  double episode_reward() const { return state_.episode_reward; }  // sum over this episode

  // kNone outside the world.
  Material material(Position p) const { return state_.board.material(p); }
  // The cells (x, y) with x inside the world, by y.
  absl::Span<const BoardCell> column(int x) const {
    return state_.board.cells().subspan(static_cast<size_t>(x) * state_.board.height(), state_.board.height());
  }
  // The live objects in order of creation; the first is the player.
  absl::Span<const Object> objects() const { return state_.board.objects(); }
  // See Board::object_room().
  size_t object_room() const { return state_.board.object_room(); }

  const Player& player() const { return state_.player; }
  Position player_position() const { return objects()[0].position; }

  // uint8[width][height], y fastest: materials, overlaid with objects (player 13, cow 14, zombie 15, skeleton 16, arrow
  // 17, plant 18). `out` has width * height elements.
  void SemanticView(absl::Span<uint8_t> out) const;

  RandomStream& random() { return state_.random; }
  const RandomStream& random() const { return state_.random; }

  // The whole game as bytes, with `stream` instead of random(): a caller that draws pictures stores the stream as it
  // was before the last picture, and redraws it after Restore(). About 8 KB, plus 24 bytes per object, for 64x64 cells.
  std::string Save(const RandomStream& stream) const;
  // Restores the state at Save(), of this world or of another with the same options. The seed is part of the
  // snapshot.
  //   InvalidArgument: the snapshot of a world with other options, or of another version.
  //   DataLoss: cut, damaged or impossible bytes. On failure the world is unchanged.
  absl::Status Restore(absl::string_view snapshot);

 private:
  friend class WorldEditor;  // stages situations; defined by tests only

  explicit World(const WorldOptions& options) : state_(options) {}

  WorldState state_;
};

}  // namespace craftfleet
