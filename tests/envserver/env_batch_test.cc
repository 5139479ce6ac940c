#include "envserver/env_batch.h"

#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/snapshot_envelope.h"
#include "envserver/game_budget.h"
#include "tests/envserver/full_game.h"
#include "tests/fakes/played_game.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

// The games of lanes 0 to `count` - 1.
std::vector<EnvBatch::OpenLane> Lanes(int count) {
  std::vector<EnvBatch::OpenLane> lanes(count);
  for (int lane = 0; lane < count; ++lane) lanes[lane].lane = lane;
  return lanes;
}

TEST(EnvBatch, RowsAreInTheOrderOfTheRequest) {
  const auto renderer = MakeRenderer();
  EnvBatch batch(renderer);
  PlayedGame three(renderer, 33);
  PlayedGame one(renderer, 11);
  std::string frames;
  ASSERT_THAT(batch.Open({{3, 33, 1, ""}, {1, 11, 1, ""}}, &frames), IsOk());
  EXPECT_EQ(frames, three.frame + one.frame);
  StepBatch step;
  for (int i = 0; i < 20; ++i) {
    const Action action = i % 2 == 0 ? Action::kMoveLeft : Action::kMoveDown;
    ASSERT_THAT(batch.Step({1, 3}, {action, Action::kDo}, /*snapshot=*/true, &step), IsOk());
    const auto of_one = one.Step(action);
    const auto of_three = three.Step(Action::kDo);
    ASSERT_EQ(step.frames, one.frame + three.frame) << i;
    EXPECT_THAT(step.rewards,
                ElementsAre(static_cast<float>(of_one.outcome.reward), static_cast<float>(of_three.outcome.reward)));
    EXPECT_THAT(step.snapshots, ElementsAre(one.game.Save(), three.game.Save()));
  }
}

TEST(EnvBatch, OnlyNamedLanesAreStepped) {
  const auto renderer = MakeRenderer();
  EnvBatch batch(renderer);
  PlayedGame two(renderer, 2);
  std::string frames;
  ASSERT_THAT(batch.Open({{1, 1, 1, ""}, {2, 2, 1, ""}}, &frames), IsOk());
  StepBatch step;
  for (int i = 0; i < 10; ++i) ASSERT_THAT(batch.Step({1}, {Action::kMoveUp}, false, &step), IsOk());
  EXPECT_THAT(step.snapshots, IsEmpty());
  ASSERT_THAT(batch.Step({2}, {Action::kMoveUp}, false, &step), IsOk());
  two.Step(Action::kMoveUp);
  EXPECT_EQ(step.frames, two.frame);
}

// A batch that pauses after each game gives the same results as one that does not.
TEST(EnvBatch, ResumesWhereItPaused) {
  const auto renderer = MakeRenderer();
  for (const FrameFormat format : {FrameFormat::kRaw, FrameFormat::kScene}) {
    EnvBatch whole(renderer, format);
    EnvBatch paused(renderer, format);
    paused.PauseWhen([] { return true; });
    const std::vector<EnvBatch::OpenLane> lanes = {{3, 33, 1, ""}, {2, 22, 1, "no snapshot"}, {1, 11, 1, ""}};
    std::string whole_frames;
    std::string paused_frames;
    ASSERT_THAT(whole.Open(lanes, &whole_frames), IsOk());
    ASSERT_THAT(paused.Open(lanes, &paused_frames), IsOk());
    for (int left = 2; left > 0; --left) {
      ASSERT_TRUE(paused.unfinished()) << left;
      ASSERT_THAT(paused.Resume(), IsOk());
    }
    EXPECT_FALSE(paused.unfinished());
    EXPECT_EQ(paused_frames, whole_frames);
    EXPECT_THAT(paused.refused(), SizeIs(1));
    StepBatch whole_step;
    StepBatch paused_step;
    for (int i = 0; i < 5; ++i) {
      const std::vector<Action> actions = {Action::kMoveLeft, Action::kDo};
      ASSERT_THAT(whole.Step({1, 3}, actions, /*snapshot=*/true, &whole_step), IsOk());
      ASSERT_THAT(paused.Step({1, 3}, actions, /*snapshot=*/true, &paused_step), IsOk());
      ASSERT_TRUE(paused.unfinished());
      ASSERT_THAT(paused.Resume(), IsOk());
      ASSERT_FALSE(paused.unfinished());
      ASSERT_EQ(paused_step.frames, whole_step.frames) << i;
      ASSERT_EQ(paused_step.snapshots, whole_step.snapshots) << i;
    }
  }
}

TEST(EnvBatch, CountsObjectsBeyondTheUsualOnesWhileTheirGamesAreOpen) {
  const auto renderer = MakeRenderer();
  const std::string full = FullSnapshot(renderer);
  EnvBatch batch(renderer);
  std::string frames;
  ASSERT_THAT(batch.Open({{1, 1, 1, ""}, {2, 2, 1, full}, {3, 3, 1, full}}, &frames), IsOk());
  const int64_t each = 64 * 64 - kUsualObjects;
  EXPECT_EQ(batch.more_objects(), 2 * each);
  ASSERT_THAT(batch.Open({{2, 2, 1, ""}}, &frames), IsOk());
  EXPECT_EQ(batch.more_objects(), each);
  batch.Close({3, 4});
  EXPECT_EQ(batch.more_objects(), 0);
}

TEST(EnvBatch, ARestoredGameSendsARecordOfItsOwn) {
  const auto renderer = MakeRenderer();
  EnvBatch first(renderer, FrameFormat::kScene);
  std::string frames;
  ASSERT_THAT(first.Open({{0, 5, 1, ""}}, &frames), IsOk());
  StepBatch step;
  for (int i = 0; i < 160; ++i) ASSERT_THAT(first.Step({0}, {Action::kNoop}, i == 159, &step), IsOk());
  EnvBatch second(renderer, FrameFormat::kScene);
  ASSERT_THAT(second.Open({{0, 5, 0, step.snapshots[0]}}, &frames), IsOk()) << "the episode of a snapshot is its own";
  EXPECT_TRUE(frames == step.frames);
  EXPECT_GT(frames.size(), 2496);  // it is night: the record has the stream
}

TEST(EnvBatch, AnEndedGameStartsItsNextEpisode) {
  const auto renderer = MakeRenderer(5);
  EnvBatch batch(renderer);
  PlayedGame played(renderer, 7);
  std::string frames;
  ASSERT_THAT(batch.Open({{0, 7, 1, ""}, {1, 7, 2, ""}}, &frames), IsOk());
  const std::string second_episode = frames.substr(played.frame.size());
  StepBatch step;
  for (int i = 0; i < 5; ++i) {
    ASSERT_THAT(batch.Step({0}, {Action::kMoveRight}, false, &step), IsOk());
    played.Step(Action::kMoveRight);
  }
  EXPECT_THAT(step.ends, ElementsAre(StepEnd::kTruncated));
  EXPECT_EQ(step.last_frames, played.last_frames);
  EXPECT_EQ(step.frames, second_episode);
  ASSERT_THAT(step.episodes, SizeIs(1));
  EXPECT_EQ(step.episodes[0].length, 5);
  ASSERT_THAT(batch.Step({0}, {Action::kNoop}, false, &step), IsOk());
  EXPECT_THAT(step.episodes, IsEmpty());
  EXPECT_EQ(step.last_frames, "");
}

// A late episode once required generating all earlier ones.
TEST(EnvBatch, ALateEpisodeEqualsTheOneReachedByPlaying) {
  const auto renderer = MakeRenderer(3);
  EnvBatch played(renderer);
  std::string frames;
  StepBatch step;
  ASSERT_THAT(played.Open({{0, 7, 1, ""}}, &frames), IsOk());
  for (int i = 0; i < 3 * 19; ++i) ASSERT_THAT(played.Step({0}, {Action::kNoop}, false, &step), IsOk());
  EnvBatch opened(renderer);
  ASSERT_THAT(opened.Open({{0, 7, 20, ""}}, &frames), IsOk());
  EXPECT_EQ(frames, step.frames);
  StepBatch other;
  for (int i = 0; i < 10; ++i) {
    ASSERT_THAT(played.Step({0}, {Action::kMoveRight}, true, &step), IsOk());
    ASSERT_THAT(opened.Step({0}, {Action::kMoveRight}, true, &other), IsOk());
    ASSERT_EQ(other.frames, step.frames);
    ASSERT_EQ(other.snapshots, step.snapshots);
  }
}

TEST(EnvBatch, OpensTheLastEpisodeAndPlaysBeyondIt) {
  EnvBatch batch(MakeRenderer(2));
  std::string frames;
  StepBatch step;
  ASSERT_THAT(batch.Open({{0, 7, EnvBatch::kMaxEpisode, ""}}, &frames), IsOk());
  for (int i = 0; i < 6; ++i) ASSERT_THAT(batch.Step({0}, {Action::kNoop}, true, &step), IsOk());
  EXPECT_THAT(batch.Open({{1, 0, 1, step.snapshots[0]}}, &frames), IsOk());
}

TEST(EnvBatch, StopsBetweenGamesOnRequest) {
  EnvBatch batch(MakeRenderer());
  std::string frames;
  int asked = 0;
  batch.StopWhen([&] { return ++asked > 1; });
  EXPECT_THAT(batch.Open(Lanes(EnvBatch::kMaxLanes), &frames),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("the client left")));
  EXPECT_EQ(asked, 2);
  EXPECT_GT(batch.size(), 0);
  EXPECT_LT(batch.size(), EnvBatch::kMaxLanes);
  batch.StopWhen([] { return false; });
  std::vector<int> numbers(32);
  std::iota(numbers.begin(), numbers.end(), 0);
  ASSERT_THAT(batch.Open(Lanes(32), &frames), IsOk());
  StepBatch step;
  const std::vector<Action> actions(32, Action::kNoop);
  ASSERT_THAT(batch.Step(numbers, actions, false, &step), IsOk());
  batch.StopWhen([] { return true; });
  absl::SleepFor(absl::Milliseconds(100));  // the callback is called several times a second
  EXPECT_THAT(batch.Step(numbers, actions, false, &step),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("the client left")));
}

// An invalid snapshot affects its own lane only.
TEST(EnvBatch, LanesWithInvalidSnapshotsAreRefusedAndOthersOpen) {
  const auto renderer = MakeRenderer();
  EnvBatch batch(renderer);
  PlayedGame one(renderer, 11);
  PlayedGame three(renderer, 33);
  const std::string in_envelope =
      SealSnapshot(EnvDigest(renderer->world_options().name, renderer->world_options().length), "no game");
  std::string large(kMaxSnapshotBytes + 1, 's');
  std::string frames;
  ASSERT_THAT(batch.Open({{4, 0, 1, ""}}, &frames), IsOk());
  ASSERT_THAT(
      batch.Open(
          {{1, 11, 1, ""}, {4, 0, 1, "no snapshot at all"}, {5, 0, 1, in_envelope}, {3, 33, 1, ""}, {6, 0, 1, large}},
          &frames),
      IsOk());
  EXPECT_EQ(frames, one.frame + three.frame);
  EXPECT_EQ(batch.size(), 2) << "the former game of lane 4 is closed too";
  ASSERT_EQ(batch.refused().size(), 3);
  EXPECT_EQ(batch.refused()[0].lane, 4);
  EXPECT_THAT(batch.refused()[0].reason, HasSubstr("18 bytes without an envelope"));
  EXPECT_EQ(batch.refused()[1].lane, 5);
  EXPECT_THAT(batch.refused()[1].reason, HasSubstr("not a world's"));
  EXPECT_EQ(batch.refused()[2].lane, 6);
  EXPECT_THAT(batch.refused()[2].reason, HasSubstr("114689 bytes, want at most 114688"));
  ASSERT_THAT(batch.Open({{4, 1, 1, ""}}, &frames), IsOk());
  EXPECT_THAT(batch.refused(), IsEmpty());
}

TEST(EnvBatch, OpeningALaneAgainRestartsIt) {
  EnvBatch batch(MakeRenderer());
  std::string frames;
  StepBatch step;
  ASSERT_THAT(batch.Open({{0, 1, 1, ""}}, &frames), IsOk());
  const std::string first = frames;
  for (int i = 0; i < 10; ++i) ASSERT_THAT(batch.Step({0}, {Action::kMoveUp}, false, &step), IsOk());
  ASSERT_THAT(batch.Open({{0, 1, 1, ""}}, &frames), IsOk());
  EXPECT_EQ(frames, first);
  EXPECT_EQ(batch.size(), 1);
}

TEST(EnvBatch, RefusesInvalidLanesAndEpisodes) {
  EnvBatch batch(MakeRenderer());
  std::string frames;
  const auto refused = [&](const EnvBatch::OpenLane& lane, const std::string& error) {
    EXPECT_THAT(batch.Open({lane}, &frames), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(error)));
  };
  refused({-1, 0, 1, ""}, "lane -1, want at least 0");
  refused({4, 0, 0, ""}, "lane 4: episode 0, want 1..1125899906842624");
  refused({4, 0, EnvBatch::kMaxEpisode + 1, ""}, "lane 4: episode 1125899906842625, want 1..1125899906842624");
  EXPECT_EQ(batch.size(), 0);
  EXPECT_THAT(batch.Open(Lanes(EnvBatch::kMaxLanes + 1), &frames),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("4097 lanes more on top of 0 open ones")));
}

// The reply had one picture and the lengths of two episodes, or of none.
TEST(EnvBatch, ALaneNamedTwiceIsNotOpened) {
  EnvBatch batch(MakeRenderer());
  std::string frames;
  EXPECT_THAT(batch.Open({{4, 1, 1, ""}, {3, 1, 1, ""}, {4, 1, 1, "junk"}}, &frames),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("lane 4 is named twice in one open")));
  EXPECT_EQ(batch.size(), 0);
}

TEST(EnvBatch, AStepOfAWrongLaneStepsNothing) {
  const auto renderer = MakeRenderer();
  EnvBatch batch(renderer);
  PlayedGame played(renderer, 1);
  std::string frames;
  StepBatch step;
  ASSERT_THAT(batch.Open({{0, 1, 1, ""}, {1, 1, 1, ""}}, &frames), IsOk());
  batch.Close({1, 17});
  EXPECT_EQ(batch.size(), 1);
  EXPECT_THAT(
      batch.Step({0, 1}, {Action::kMoveUp, Action::kMoveUp}, false, &step),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("lane 1 is not open in this session, which has 1")));
  EXPECT_THAT(batch.Step({0, 0}, {Action::kMoveUp, Action::kMoveUp}, false, &step),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("lane 0 is named twice")));
  ASSERT_THAT(batch.Step({0}, {Action::kMoveUp}, true, &step), IsOk());
  played.Step(Action::kMoveUp);
  EXPECT_EQ(step.frames, played.frame);
  EXPECT_THAT(step.snapshots, ElementsAre(played.game.Save()));
}

}  // namespace
}  // namespace craftfleet
