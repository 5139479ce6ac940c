// The snapshot of a game: if it restores, the game can be played, saved and restored again.

#include "common/base/check.h"
#include "common/base/crc32c.h"
#include "envserver/world/world.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

constexpr size_t kChecksumAt = 8;
constexpr size_t kHeaderBytes = 12;

World NewWorld() { return *World::Create(WorldOptions(), 1); }

// `input` with a correct checksum, so that the search gets past it.
std::string Sealed(absl::string_view input) {
  std::string bytes(input);
  if (bytes.size() < kHeaderBytes) return bytes;
  const uint32_t checksum = Crc32c(absl::string_view(bytes).substr(kHeaderBytes));
  for (size_t i = 0; i < 4; ++i) bytes[kChecksumAt + i] = static_cast<char>(checksum >> (8 * i));
  return bytes;
}

}  // namespace

void TryInput(absl::string_view input) {
  World world = NewWorld();
  const std::string before = world.Save(world.random());
  if (!world.Restore(Sealed(input)).ok()) {
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

}  // namespace craftfleet
