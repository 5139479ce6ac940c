// Scene records, one after another: each is drawn or refused, and two readers draw the same.

#include "common/base/check.h"
#include "envserver/game.h"
#include "tests/fuzz/fuzz_target.h"

namespace craftfleet {
namespace {

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

}  // namespace

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

}  // namespace craftfleet
