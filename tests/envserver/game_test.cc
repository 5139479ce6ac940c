#include "envserver/game.h"

#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/played_game.h"
#include "tests/fakes/status_matchers.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

using testing::_;

struct Played : PlayedGame {
  using PlayedGame::PlayedGame;
  WorldState& state() { return WorldEditor::State(const_cast<World*>(&game.world())); }
};

Action RandomAction(RandomStream* random) { return static_cast<Action>(random->Below(kNumActions)); }

// Saves `played` and restores it into another game: both continue identically.
void ExpectToGoOnTheSame(Played* played, const std::shared_ptr<const Renderer>& renderer) {
  Played other(renderer, 999);
  for (int i = 0; i < 30; ++i) other.Step(Action::kMoveUp);
  ASSERT_THAT(other.game.Restore(played->game.Save(), other.Bytes()), IsOk());
  EXPECT_EQ(other.frame, played->frame);
  EXPECT_EQ(other.game.Save(), played->game.Save());
  RandomStream actions(5);
  for (int i = 0; i < 200; ++i) {
    const Action action = RandomAction(&actions);
    const Game::PlayedStep expected = played->Step(action);
    const Game::PlayedStep actual = other.Step(action);
    ASSERT_EQ(actual.outcome.reward, expected.outcome.reward) << i;
    ASSERT_EQ(actual.outcome.end, expected.outcome.end) << i;
    ASSERT_EQ(actual.episode.has_value(), expected.episode.has_value()) << i;
    ASSERT_EQ(other.frame, played->frame) << i;
  }
}

TEST(Game, RestoredByDayContinuesIdentically) {
  const auto renderer = MakeRenderer();
  Played played(renderer, 1);
  ExpectToGoOnTheSame(&played, renderer);
}

TEST(Game, RestoredByNightContinuesIdentically) {
  const auto renderer = MakeRenderer();
  Played played(renderer, 2);
  played.state().step = 199;
  for (int i = 0; i < 3; ++i) played.Step(Action::kNoop);
  ASSERT_LT(played.game.world().daylight(), 0.1);
  ExpectToGoOnTheSame(&played, renderer);
}

TEST(Game, RestoredAsleepContinuesIdentically) {
  const auto renderer = MakeRenderer();
  Played played(renderer, 3);
  played.state().step = 160;
  played.state().player.item(Item::kEnergy) = 1;
  for (int i = 0; i < 3; ++i) played.Step(Action::kSleep);
  ASSERT_TRUE(played.game.world().player().sleeping);
  ExpectToGoOnTheSame(&played, renderer);
}

TEST(Game, RestoredAfterATruncationContinuesIdentically) {
  const auto renderer = MakeRenderer(165);
  Played played(renderer, 4);
  for (int i = 0; i < 164; ++i) ASSERT_EQ(played.Step(Action::kNoop).outcome.end, StepEnd::kNone) << i;
  ASSERT_EQ(played.Step(Action::kNoop).outcome.end, StepEnd::kTruncated);
  ASSERT_EQ(played.game.world().episode(), 2);
  ExpectToGoOnTheSame(&played, renderer);
}

// The next step would end an episode that is longer than the options allow, or play on after a death.
TEST(Game, SnapshotOfAGameThatHasEndedIsRefusedAndChangesNothing) {
  const auto renderer = MakeRenderer(500);
  Played played(renderer, 1);
  const std::string before = played.game.Save();
  for (const bool is_dead : {false, true}) {
    Played ended(renderer, 2);
    if (is_dead) {
      ended.state().player.item(Item::kHealth) = 0;
      ended.state().last_health = 0;
      ended.state().episode_reward = -0.9;
    } else {
      ended.state().step = 500;
    }
    EXPECT_THAT(played.game.Restore(ended.game.Save(), played.Bytes()),
                StatusIs(absl::StatusCode::kDataLoss, testing::HasSubstr("of a game that has ended")));
  }
  EXPECT_EQ(played.game.Save(), before);
}

TEST(Game, SnapshotOfAnotherGameIsRefusedAndChangesNothing) {
  Played longer(MakeRenderer(10000), 1);
  Played shorter(MakeRenderer(500), 1);
  shorter.Step(Action::kMoveLeft);
  const std::string frame = shorter.frame;
  const std::string before = shorter.game.Save();
  EXPECT_THAT(shorter.game.Restore(longer.game.Save(), shorter.Bytes()),
              StatusIs(absl::StatusCode::kInvalidArgument, _));
  EXPECT_EQ(shorter.frame, frame);
  EXPECT_EQ(shorter.game.Save(), before);
}

// Against the same game played with Crafter's loop of step and reset.
TEST(Game, AutoResetMatchesStepAndReset) {
  const auto renderer = MakeRenderer(170);
  Played automatic(renderer, 6);
  Played manual(renderer, 6);
  RandomStream actions(6);
  int truncated = 0;
  int died = 0;
  for (int i = 0; i < 2000; ++i) {
    const Action action = RandomAction(&actions);
    automatic.last_frames.clear();
    const Game::PlayedStep played = automatic.Step(action);
    const StepOutcome outcome = manual.game.Step(action, manual.Bytes());
    ASSERT_EQ(played.outcome.reward, outcome.reward);
    ASSERT_EQ(played.outcome.end, outcome.end);
    ASSERT_EQ(played.outcome.unlocked, outcome.unlocked);
    if (outcome.end == StepEnd::kTruncated) {
      ++truncated;
      ASSERT_EQ(automatic.last_frames, manual.frame);
    } else {
      ASSERT_EQ(automatic.last_frames, "");
    }
    died += outcome.end == StepEnd::kTerminated;
    if (outcome.end != StepEnd::kNone) manual.game.Reset(manual.Bytes());
    ASSERT_EQ(automatic.frame, manual.frame) << i;
  }
  EXPECT_GT(truncated, 0);
  EXPECT_GT(died, 0);
}

TEST(Game, AFinishedEpisodeIsReported) {
  Played played(MakeRenderer(40), 7);
  double reward = 0;
  for (int i = 0; i < 39; ++i) reward += played.Step(Action::kMoveRight).outcome.reward;
  played.state().player.achievements[static_cast<int>(Achievement::kEatCow)] = 3;
  const Game::PlayedStep last = played.Step(Action::kMoveRight);
  ASSERT_TRUE(last.episode.has_value());
  EXPECT_EQ(last.episode->length, 40);
  EXPECT_DOUBLE_EQ(last.episode->reward, reward + last.outcome.reward);
  EXPECT_EQ(last.episode->achievements[static_cast<int>(Achievement::kEatCow)], 3);
  EXPECT_EQ(played.game.world().step(), 0);
  EXPECT_FALSE(played.Step(Action::kNoop).episode.has_value());
}

TEST(Game, TheGameUsesTheRenderersWorldOptions) {
  Played played(MakeRenderer(123), 8);
  EXPECT_EQ(played.game.world().options().length, 123);
  EXPECT_EQ(played.game.world().seed(), 8);
  EXPECT_EQ(played.game.world().episode(), 1);
}

}  // namespace
}  // namespace craftfleet
