// A step allocates no memory, whatever it draws, balances or resets. A program of its own: it replaces operator new.

#include <atomic>
#include <cstdlib>
#include <new>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "common/io/paths.h"
#include "envserver/game.h"
#include "tests/fakes/status_matchers.h"

namespace {
std::atomic<int64_t> allocations = 0;
}  // namespace

void* operator new(size_t size) {
  ++allocations;
  void* memory = std::malloc(size);
  if (memory == nullptr) std::abort();
  return memory;
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, size_t /*size*/) noexcept { std::free(memory); }

namespace craftfleet {
namespace {

TEST(GameAllocation, StepsAndResetsAllocateNothing) {
  const auto textures = Textures::Load(*DefaultTextureDir());
  ASSERT_THAT(textures, IsOk());
  const auto renderer = Renderer::Create(**textures, WorldOptions(), RenderOptions());
  ASSERT_THAT(renderer, IsOk());
  std::vector<uint8_t> frame((*renderer)->frame_bytes());
  absl::StatusOr<Game> game = Game::Create(*renderer, 3, absl::MakeSpan(frame));
  ASSERT_THAT(game, IsOk());
  RandomStream actions(1);
  std::string last_frames;
  int ended = 0;
  int nights = 0;
  const int64_t before = allocations;
  EXPECT_GT(before, 0);
  for (int i = 0; i < 4000; ++i) {
    const auto action = static_cast<Action>(actions.Below(kNumActions));
    ended += game->StepAndAutoReset(action, absl::MakeSpan(frame), &last_frames).episode.has_value() ? 1 : 0;
    nights += game->world().daylight() < kNoiseBelow ? 1 : 0;
  }
  EXPECT_EQ(allocations - before, 0);
  std::string records;
  records.reserve(1 << 16);
  last_frames.reserve(1 << 16);
  const int64_t before_records = allocations;
  for (int i = 0; i < 2000; ++i) {
    records.clear();
    const auto action = static_cast<Action>(actions.Below(kNumActions));
    game->StepAndRecord(action, /*anew=*/i % 32 == 0, &records, &last_frames);
  }
  EXPECT_EQ(allocations - before_records, 0);
  EXPECT_GT(ended, 5);
  EXPECT_GT(nights, 100);
}

}  // namespace
}  // namespace craftfleet
