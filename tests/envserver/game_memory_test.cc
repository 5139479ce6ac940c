// Games take no more memory than is counted for them, and steps allocate none. A program of its own: it replaces
// operator new.

#include <malloc.h>

#include <atomic>
#include <cstdlib>
#include <memory>
#include <new>
#include <numeric>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/paths.h"
#include "common/wire/server.h"
#include "envserver/env_batch.h"
#include "envserver/env_service.h"
#include "envserver/game_budget.h"
#include "tests/envserver/full_game.h"
#include "tests/envserver/test_session.h"
#include "tests/fakes/played_game.h"
#include "tests/fakes/status_matchers.h"

namespace {
std::atomic<int64_t> bytes_in_use = 0;
std::atomic<int64_t> allocations = 0;
}  // namespace

void* operator new(size_t size) {
  void* memory = std::malloc(size);
  if (memory == nullptr) std::abort();
  ++allocations;
  bytes_in_use += static_cast<int64_t>(malloc_usable_size(memory));
  return memory;
}
void operator delete(void* memory) noexcept {
  bytes_in_use -= static_cast<int64_t>(malloc_usable_size(memory));
  std::free(memory);
}
void operator delete(void* memory, size_t /*size*/) noexcept { operator delete(memory); }

namespace craftfleet {
namespace {

constexpr int kGames = 8;
constexpr int kMessages = 1;  // that gRPC makes of a reply, beside the reply

// Plays games from `snapshot` (empty: new ones), and checks after each step what they take.
void ExpectToFit(const std::string& snapshot) {
  const std::shared_ptr<const Renderer> renderer = MakeRenderer();
  const PlayedGame first(renderer, 1);  // makes the tables that all worlds share
  const int64_t before = bytes_in_use;
  EnvBatch batch(renderer);
  std::vector<EnvBatch::OpenLane> lanes;
  for (int lane = 0; lane < kGames; ++lane) lanes.push_back({lane, lane, 1, snapshot});
  std::string frames;
  ASSERT_THAT(batch.Open(lanes, &frames), IsOk());
  ASSERT_THAT(batch.refused(), testing::IsEmpty());
  RandomStream actions(1);
  StepBatch step;
  for (int t = 0; t < 300; ++t) {
    std::vector<int> numbers;
    std::vector<Action> chosen;
    for (int lane = 0; lane < kGames; ++lane) {
      numbers.push_back(lane);
      chosen.push_back(static_cast<Action>(actions.Below(kNumActions)));
    }
    ASSERT_THAT(batch.Step(numbers, chosen, /*snapshot=*/true, &step), IsOk());
    int64_t message = static_cast<int64_t>(step.frames.size() + step.last_frames.size());
    for (const std::string& saved : step.snapshots) message += static_cast<int64_t>(saved.size());
    const int64_t counted = SessionBytes(kGames, batch.more_objects(), renderer->frame_bytes(), false, 0) -
                            SessionBytes(0, 0, renderer->frame_bytes(), false, 0);
    ASSERT_LE(bytes_in_use - before + kMessages * message, counted) << "step " << t;
  }
}

TEST(GameMemory, OfNewGamesIsCounted) { ExpectToFit(""); }

// Its objects alone took 160 KiB of the 64 that were counted.
TEST(GameMemory, OfGamesWithAnObjectOnEveryCellIsCounted) { ExpectToFit(FullSnapshot(MakeRenderer())); }

// A session that closed its games kept their pictures, uncounted.
TEST(GameMemory, OfClosedGamesIsFree) {
  constexpr int kMany = 256;
  const PlayedGame first(MakeRenderer(), 1);  // makes the tables that all worlds share
  const auto service = *EnvServiceImpl::Create(*DefaultTextureDir());
  const auto server = *wire::Server::Create({}, {service.get()});
  Session session(server->InProcess());
  ASSERT_THAT(session.Send(Hello("")), IsOk());
  std::vector<int> lanes(kMany);
  std::iota(lanes.begin(), lanes.end(), 0);
  v1::PlayRequest close;
  close.mutable_close()->mutable_lanes()->Assign(lanes.begin(), lanes.end());
  const int64_t before = bytes_in_use;
  ASSERT_THAT(session.Send(OpenMany(kMany)), IsOk());
  ASSERT_THAT(session.Send(Step(lanes, std::string(kMany, '\0'))), IsOk());
  ASSERT_THAT(session.Send(close), IsOk());
  EXPECT_LT(bytes_in_use - before, 1 << 20);
}

// Whatever it draws, balances or resets.
TEST(GameMemory, StepsAndResetsAllocateNothing) {
  PlayedGame played(MakeRenderer(), 3);
  RandomStream actions(1);
  std::string records;
  records.reserve(1 << 16);
  played.last_frames.reserve(1 << 16);
  int ended = 0;
  int nights = 0;
  const int64_t before = allocations;
  EXPECT_GT(before, 0);
  for (int i = 0; i < 6000; ++i) {
    records.clear();
    played.last_frames.clear();
    const auto action = static_cast<Action>(actions.Below(kNumActions));
    if (i < 4000) {
      ended += played.Step(action).episode.has_value() ? 1 : 0;
    } else {
      played.game.StepAndRecord(action, /*anew=*/i % 32 == 0, &records, &played.last_frames);
    }
    nights += played.game.world().daylight() < kNoiseBelow ? 1 : 0;
  }
  EXPECT_EQ(allocations - before, 0);
  EXPECT_GT(ended, 3);
  EXPECT_GT(nights, 100);
}

}  // namespace
}  // namespace craftfleet
