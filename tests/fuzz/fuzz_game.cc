// Games: snapshots, textures and scene records.

#include "common/base/check.h"
#include "common/io/files.h"
#include "common/io/paths.h"
#include "common/io/snapshot_envelope.h"
#include "envserver/game.h"
#include "envserver/render/textures.h"
#include "envserver/world/world.h"
#include "tests/envserver/world/invariants.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

// The snapshot of a game: if it restores, the game can be played, saved and restored again.
namespace world_snapshot {

World NewWorld() { return *World::Create(WorldOptions(), 1); }

void TryInput(absl::string_view input) {
  World world = NewWorld();
  const std::string before = world.Save(world.random());
  if (!world.Restore(Sealed(std::string(input))).ok()) {
    CRAFTFLEET_CHECK(world.Save(world.random()) == before);
    return;
  }
  World again = NewWorld();
  CRAFTFLEET_CHECK(again.Restore(world.Save(world.random())).ok());
  for (int step = 0; step < 24; ++step) {
    const Action action = static_cast<Action>(step % kNumActions);
    const StepOutcome outcome = world.Step(action);
    CRAFTFLEET_CHECK(again.Step(action).reward == outcome.reward);
    if (outcome.end != StepEnd::kNone) break;
  }
  const std::string saved = world.Save(world.random());
  CRAFTFLEET_CHECK(again.Save(again.random()) == saved);
  CRAFTFLEET_CHECK(again.Restore(saved).ok());
}

std::vector<std::string> SoundInputs() {
  std::vector<std::string> inputs;
  World world = NewWorld();
  for (int step = 0; step <= 120; ++step) {
    if (step % 60 == 0) inputs.push_back(world.Save(world.random()));
    world.Step(static_cast<Action>((step * 5 + 1) % kNumActions));
  }
  return inputs;
}

const FuzzTarget kTarget("world_snapshot", TryInput, SoundInputs);

}  // namespace world_snapshot

// The envelope of a game's snapshot: sealing an opened game must restore the same bytes. If the first byte is even, the
// rest is the whole snapshot; otherwise it is a game in a valid envelope.
namespace snapshot_envelope {

constexpr uint64_t kEnv = 0x0123456789abcdef;
constexpr uint64_t kOtherEnv = kEnv + 1;

void TryInput(absl::string_view input) {
  if (input.empty()) return;
  const absl::string_view rest = input.substr(1);
  const bool is_game = (input[0] & 1) != 0;
  const std::string sealed = is_game ? SealSnapshot(kEnv, rest) : std::string(rest);
  const auto game = OpenSnapshot(kEnv, sealed);
  CRAFTFLEET_CHECK(CheckSnapshot(kEnv, sealed).ok() == (game.ok() || sealed.empty()));
  if (is_game) CRAFTFLEET_CHECK(game.ok() == (sealed.size() <= kMaxSnapshotBytes));
  if (!game.ok()) {
    CRAFTFLEET_CHECK(game.status().code() == absl::StatusCode::kInvalidArgument);
    return;
  }
  CRAFTFLEET_CHECK(sealed.size() <= kMaxSnapshotBytes);
  CRAFTFLEET_CHECK(SealSnapshot(kEnv, *game) == sealed);
  CRAFTFLEET_CHECK(!OpenSnapshot(kOtherEnv, sealed).ok());
}

std::vector<std::string> SoundInputs() {
  const std::string sealed = SealSnapshot(kEnv, "a game");
  std::string damaged = sealed;
  damaged.back() ^= 1;
  return {'\0' + sealed,
          '\0' + damaged,
          '\0' + sealed.substr(0, sealed.size() - 1),
          '\0' + sealed.substr(0, 12),
          '\0' + SealSnapshot(kOtherEnv, "a game"),
          '\0' + SealSnapshot(kEnv, ""),
          std::string(1, '\0'),
          "\1a game",
          '\1' + std::string(kMaxSnapshotBytes, 'g')};
}

const FuzzTarget kTarget("snapshot_envelope", TryInput, SoundInputs);

}  // namespace snapshot_envelope

// The bytes of a texture file: refused, or a picture of 16x16 pixels.
namespace texture {

void TryInput(absl::string_view input) {
  const auto texture = DecodeTexture(std::string(input), "input.png");
  CRAFTFLEET_CHECK(texture.ok() || texture.status().code() == absl::StatusCode::kInvalidArgument);
}

std::vector<std::string> SoundInputs() {
  const std::string folder = DefaultTextureDir().value();
  std::vector<std::string> inputs;
  for (const char* name : {"grass.png", "player.png", "1.png"}) {
    inputs.push_back(ReadFile(JoinPath(folder, name)).value());
  }
  return inputs;
}

const FuzzTarget kTarget("texture", TryInput, SoundInputs);

}  // namespace texture

// Scene records, one after another: each is drawn or refused, and two readers draw the same.
namespace scene_record {

constexpr int kMaxRecords = 64;  // of an input; each takes some microseconds

// Appearance variants make most sprites possible.
const std::shared_ptr<const Renderer>& SharedRenderer() {
  static const auto* const renderer = [] {
    WorldOptions world;
    world.appearance = "tczsuk";
    return new std::shared_ptr<const Renderer>(*Renderer::Create(*Textures::BuiltIn(), world, RenderOptions()));
  }();
  return *renderer;
}

void TryInput(absl::string_view input) {
  const Renderer& renderer = *SharedRenderer();
  std::string one(renderer.frame_bytes(), '\1');
  std::string other(renderer.frame_bytes(), '\2');
  SceneReader reader;
  SceneReader second_reader;
  absl::string_view second_input = input;
  for (int i = 0; i < kMaxRecords && !input.empty(); ++i) {
    const size_t before = input.size();
    const bool drawn = reader.Draw(renderer, &input, FrameBytes(&one)).ok();
    CRAFTFLEET_CHECK(second_reader.Draw(renderer, &second_input, FrameBytes(&other)).ok() == drawn);
    if (!drawn) return;
    CRAFTFLEET_CHECK(input.size() < before);
    CRAFTFLEET_CHECK(one == other);
  }
}

std::vector<std::string> SoundInputs() {
  std::vector<std::string> inputs;
  std::string frame(SharedRenderer()->frame_bytes(), '\0');
  Game game = *Game::Create(SharedRenderer(), 3, FrameBytes(&frame));
  std::string last_frames;
  for (int step = 0; step < 300; ++step) {
    if (step % 30 == 0) inputs.emplace_back();
    game.StepAndRecord(static_cast<Action>(step * 5 % kNumActions), /*anew=*/step % 30 == 0, &inputs.back(),
                       &last_frames);
  }
  return inputs;
}

const FuzzTarget kTarget("scene_record", TryInput, SoundInputs);

}  // namespace scene_record

}  // namespace
}  // namespace craftfleet
