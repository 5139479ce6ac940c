// Moments of games that are recorded.

#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/keyed_random.h"
#include "envserver/env_batch.h"
#include "tests/fakes/played_game.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

constexpr int kPictureSize = 144;

Action ActionAt(int step) {
  return static_cast<Action>(KeyedBits(RandomUse::kActionNoise, 5, 0, static_cast<uint64_t>(step)) % kNumActions);
}

// Over a night and several ends: taking moments must not change the game's random stream.
TEST(Recording, DoesNotChangeTheGame) {
  const auto renderer = MakeRenderer(260);
  EnvBatch plain(renderer);
  EnvBatch recorded(renderer);
  recorded.Record(MakeRenderer(260, kPictureSize));
  std::string frames;
  std::string recorded_frames;
  ASSERT_THAT(plain.Open({{0, 7, 1, ""}}, &frames), IsOk());
  ASSERT_THAT(recorded.Open({{0, 7, 1, ""}}, &recorded_frames), IsOk());
  EXPECT_EQ(recorded_frames, frames);
  StepBatch step;
  StepBatch recorded_step;
  int ends = 0;
  for (int i = 0; i < 600; ++i) {
    ASSERT_THAT(plain.Step({0}, {ActionAt(i)}, true, &step), IsOk());
    ASSERT_THAT(recorded.Step({0}, {ActionAt(i)}, true, &recorded_step), IsOk());
    ASSERT_EQ(recorded_step.frames, step.frames) << i;
    ASSERT_EQ(recorded_step.last_frames, step.last_frames);
    ASSERT_EQ(recorded_step.rewards, step.rewards);
    ASSERT_EQ(recorded_step.ends, step.ends);
    ASSERT_EQ(recorded_step.snapshots, step.snapshots);
    ASSERT_EQ(recorded_step.episodes.size(), step.episodes.size());
    if (step.ends[0] == StepEnd::kNone) continue;
    ++ends;
    EXPECT_EQ(recorded_step.episodes[0].length, step.episodes[0].length);
    EXPECT_EQ(recorded_step.episodes[0].reward, step.episodes[0].reward);
    EXPECT_EQ(recorded_step.episodes[0].achievements, step.episodes[0].achievements);
  }
  EXPECT_GE(ends, 2);
  EXPECT_THAT(plain.moments(), IsEmpty());
}

TEST(Recording, HasEachMomentOfAnEpisodeUpToItsLast) {
  constexpr int kLength = 40;
  const auto renderer = MakeRenderer(kLength);
  PlayedGame played(renderer, 7);  // with Crafter's own step
  EnvBatch batch(renderer);
  batch.Record(MakeRenderer(kLength, kPictureSize));
  std::string frames;
  StepBatch step;
  ASSERT_THAT(batch.Open({{3, 7, 1, ""}}, &frames), IsOk());
  const auto larger = MakeRenderer(kLength, kPictureSize);
  for (int i = 0; i <= kLength; ++i) {
    SCOPED_TRACE(i);
    if (i > 0) {
      ASSERT_THAT(batch.Step({3}, {ActionAt(i)}, false, &step), IsOk());
      played.game.Step(ActionAt(i), played.Bytes());
    }
    ASSERT_THAT(batch.moments(), SizeIs(1));
    const Moment& moment = batch.moments()[0];
    const World& world = played.game.world();
    ASSERT_EQ(moment.frame, played.frame);
    ASSERT_EQ(moment.player_x, world.player_position().x);
    ASSERT_EQ(moment.player_y, world.player_position().y);
    ASSERT_EQ(static_cast<int>(moment.semantic[moment.player_x * 64 + moment.player_y]), 13);
    ASSERT_EQ(moment.inventory[0], world.player().health());
    ASSERT_EQ(moment.achievements, world.player().achievements);
    std::string picture(larger->frame_bytes(), '\0');
    RandomStream random = played.game.before_picture();
    larger->Render(world, &random, FrameBytes(&picture));
    ASSERT_EQ(moment.picture, picture);
  }
  EXPECT_EQ(step.ends[0], StepEnd::kTruncated);
  EXPECT_NE(step.frames, batch.moments()[0].frame) << "the next episode's first frame";
}

// The frame of a death, which is drawn only when recording.
TEST(Recording, HasTheFrameOfADeath) {
  const auto renderer = MakeRenderer();
  PlayedGame played(renderer, 7);
  EnvBatch batch(renderer);
  batch.Record(nullptr);
  std::string frames;
  StepBatch step;
  ASSERT_THAT(batch.Open({{0, 7, 1, ""}}, &frames), IsOk());
  int length = 0;
  do {
    ASSERT_THAT(batch.Step({0}, {Action::kNoop}, false, &step), IsOk());
    played.game.Step(Action::kNoop, played.Bytes());
  } while (++length < 5000 && step.ends[0] == StepEnd::kNone);
  ASSERT_EQ(step.ends[0], StepEnd::kTerminated);
  EXPECT_EQ(batch.moments()[0].frame, played.frame);
  EXPECT_EQ(batch.moments()[0].inventory[0], 0) << "health";
  EXPECT_EQ(batch.moments()[0].picture, "");
}

TEST(Recording, TooManyLargePicturesAreRefused) {
  const auto renderer = MakeRenderer(100);
  EnvBatch batch(renderer);
  batch.Record(MakeRenderer(100, 1024));
  std::string frames;
  std::vector<EnvBatch::OpenLane> many(22);
  for (int lane = 0; lane < 22; ++lane) many[lane].lane = lane;
  EXPECT_THAT(
      batch.Open(many, &frames),
      StatusIs(
          absl::StatusCode::kInvalidArgument,
          HasSubstr(
              "22 lanes more on top of 0 open ones, want at most 21 in a session that records pictures of this size")));
}

}  // namespace
}  // namespace craftfleet
