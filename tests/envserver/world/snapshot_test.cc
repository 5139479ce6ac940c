#include <cstdint>
#include <functional>
#include <random>
#include <string>

#include <gmock/gmock.h>

#include "common/io/snapshot_envelope.h"
#include "envserver/world/world.h"
#include "tests/envserver/world/invariants.h"
#include "tests/fakes/status_matchers.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

World NewWorld(const WorldOptions& options = {}, int64_t seed = 5) { return *World::Create(options, seed); }

// A world after some steps, with creatures.
World PlayedWorld() {
  WorldOptions options;
  options.appearance = "tczsuk";
  options.percentages = {25, 25, 25, 25};
  World world = NewWorld(options);
  for (int i = 0; i < 60; ++i) world.Step(static_cast<Action>(i % 6));
  return world;
}

std::string Save(const World& world) { return world.Save(world.random()); }

TEST(Snapshot, RestoresInAnotherWorldWithTheSameOptions) {
  const World saved = PlayedWorld();
  World other = NewWorld(saved.options(), 99);
  ASSERT_THAT(other.Restore(Save(saved)), IsOk());
  EXPECT_EQ(other.seed(), saved.seed());
  EXPECT_EQ(other.step(), 60);
  EXPECT_EQ(other.daylight(), saved.daylight());
  EXPECT_EQ(other.episode_reward(), saved.episode_reward());
  EXPECT_EQ(Save(other), Save(saved));
}

TEST(Snapshot, StoresTheGivenStream) {
  const World saved = PlayedWorld();
  RandomStream stream(1234);
  for (int i = 0; i < 1001; ++i) stream.Below(2);
  World other = NewWorld(saved.options());
  ASSERT_THAT(other.Restore(saved.Save(stream)), IsOk());
  EXPECT_EQ(other.random().position(), stream.position());
  for (int i = 0; i < 1000; ++i) ASSERT_EQ(other.random().Uniform(), stream.Uniform()) << i;
}

TEST(Snapshot, IsAtMost64KilobytesFor64x64Cells) {
  WorldOptions options;
  options.numbers = {0.2, 0.4, 0.91, 0.96, 0.8};  // the settings with the most things
  EXPECT_LT(Save(NewWorld(options)).size(), 64u << 10);
  EXPECT_LT(Save(NewWorld()).size(), 12u << 10);
}

// Whatever is on the cells, a fleet must be able to send the game.
TEST(Snapshot, OfAFullWorldFitsItsEnvelope) {
  World world = NewWorld();
  WorldEditor::FillWithPlants(&world);
  const std::string snapshot = Save(world);
  EXPECT_GT(snapshot.size(), 64u << 10);
  EXPECT_LE(SealSnapshot(0, snapshot).size(), kMaxSnapshotBytes);
  EXPECT_THAT(NewWorld().Restore(snapshot), IsOk());
}

// Such a game would end with an episode that learners refuse, whoever plays it.
TEST(Snapshot, WithNumbersThatItsStepsCannotLeaveIsRefused) {
  const World played = PlayedWorld();
  const auto restore = [&](const std::function<void(WorldState*)>& change) {
    World changed = played;
    change(&WorldEditor::State(&changed));
    return NewWorld(played.options()).Restore(Save(changed));
  };
  ASSERT_THAT(restore([](WorldState*) {}), IsOk());
  EXPECT_THAT(restore([](WorldState* state) { state->player.achievements[3] = 61; }),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("achievement 61 after 60 steps")));
  for (const double reward : {-0.91, 22.1, 1e9}) {
    EXPECT_THAT(restore([&](WorldState* state) { state->episode_reward = reward; }),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr("episode reward")));
  }
  EXPECT_THAT(restore([](WorldState* state) { state->last_health = 1; }),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("last health 1, want the player's")));
}

// Balancing would look for a creature that is not there.
TEST(Snapshot, WithAnEntryOfTwoObjectsIsRefused) {
  World played = PlayedWorld();
  Board& board = WorldEditor::State(&played).board;
  ASSERT_GT(board.objects().size(), 3u);
  board.object(3).entered = board.object(2).entered;
  EXPECT_THAT(NewWorld(played.options()).Restore(Save(played)),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("object 3 has another object's entry")));
}

TEST(Snapshot, OfAWorldWithOtherOptionsIsRefused) {
  const std::string snapshot = Save(NewWorld());
  WorldOptions larger;
  larger.width = 65;
  WorldOptions longer;
  longer.length = 0;
  WorldOptions rarer;
  rarer.numbers.tree = 0.9;
  WorldOptions varied;
  varied.appearance = "t";
  for (const WorldOptions& options : {larger, longer, rarer, varied}) {
    World world = NewWorld(options);
    const std::string before = Save(world);
    EXPECT_THAT(world.Restore(snapshot), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("other options")));
    EXPECT_EQ(Save(world), before);
  }
}

TEST(Snapshot, OfAnotherVersionIsRefused) {
  World world = NewWorld();
  std::string snapshot = Save(world);
  snapshot[7] = 2;
  EXPECT_THAT(world.Restore(snapshot), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("version 2, want 1")));
}

TEST(Snapshot, TruncatedAtAnyLengthIsRefused) {
  World world = PlayedWorld();
  const std::string snapshot = Save(world);
  for (size_t size = 0; size < snapshot.size(); ++size) {
    ASSERT_THAT(world.Restore(snapshot.substr(0, size)), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("snapshot")))
        << size;
  }
  EXPECT_THAT(world.Restore(snapshot + "x"), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("checksum")));
  EXPECT_EQ(Save(world), snapshot);
}

TEST(Snapshot, TruncatedWithAValidChecksumIsRefused) {
  World world = PlayedWorld();
  const std::string snapshot = Save(world);
  for (size_t size = kSnapshotBodyAt; size < snapshot.size(); size += size < 300 ? 1 : 37) {
    ASSERT_THAT(world.Restore(Sealed(snapshot.substr(0, size))),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr("snapshot")))
        << size;
  }
  EXPECT_THAT(world.Restore(Sealed(snapshot + "x")), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("left over")));
}

TEST(Snapshot, WithAnyByteFlippedIsRefused) {
  World world = PlayedWorld();
  const std::string snapshot = Save(world);
  std::mt19937 random(1);
  for (int i = 0; i < 2000; ++i) {
    std::string flipped = snapshot;
    flipped[random() % flipped.size()] ^= static_cast<char>(1 + random() % 255);
    ASSERT_FALSE(world.Restore(flipped).ok()) << i;
  }
  EXPECT_EQ(Save(world), snapshot);
}

// An adversary's snapshot has a correct checksum: it must be refused or yield a playable world.
TEST(Snapshot, HostileOnesAreRefusedOrPlayable) {
  const World played = PlayedWorld();
  const std::string snapshot = Save(played);
  std::mt19937 random(2);
  int refused = 0;
  for (int i = 0; i < 3000; ++i) {
    World world = played;
    std::string hostile = snapshot;
    for (uint32_t flips = 1 + random() % 4; flips > 0; --flips) {
      // More changes in structured parts than in the stream's words and the cells.
      const size_t at = random() % 3 == 0   ? random() % hostile.size()
                        : random() % 2 == 0 ? kSnapshotBodyAt + random() % 280
                                            : hostile.size() - 1 - random() % 2500;
      hostile[at] = static_cast<char>(random());
    }
    if (!world.Restore(Sealed(hostile)).ok()) {
      ++refused;
      ASSERT_EQ(Save(world), snapshot) << i;
      continue;
    }
    for (int step = 0; step < 12; ++step) world.Step(static_cast<Action>(random() % kNumActions));
    world.Reset();
    ASSERT_EQ(BrokenInvariant(world), "") << i;
  }
  EXPECT_GT(refused, 1000);
  EXPECT_LT(refused, 3000);
}

}  // namespace
}  // namespace craftfleet
