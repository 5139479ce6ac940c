#include "deploy/cli/play/play_session.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "deploy/cli/screen/terminal_screen.h"
#include "tests/fakes/status_matchers.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

using testing::Contains;
using testing::EndsWith;
using testing::Field;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

PlaySession::Options SmallOptions() {
  PlaySession::Options options;
  options.seed = 7;
  options.textures = Textures::BuiltIn();
  options.start = absl::FromCivil(absl::CivilSecond(2024, 2, 29, 12, 0, 0), absl::UTCTimeZone());
  return options;
}

auto HasLine(const std::string& text) { return Contains(Field(&TextLine::text, HasSubstr(text))); }

TEST(PlaySession, IsTheGameOfSeedAndEpisode) {
  PlaySession::Options options = SmallOptions();
  options.episode = 3;
  const auto session = PlaySession::Create(options);
  ASSERT_THAT(session, IsOk());
  ASSERT_THAT((*session)->Step(Action::kMoveLeft), IsOk());
  EXPECT_EQ((*session)->world().seed(), 7);
  EXPECT_EQ((*session)->world().episode(), 3);
  EXPECT_EQ((*session)->world().step(), 1);
  EXPECT_THAT((*session)->Panel(), HasLine("seed 7, episode 3"));
}

TEST(PlaySession, PicturesDoNotChangeTheGame) {
  const auto watched = PlaySession::Create(SmallOptions());
  const auto unwatched = PlaySession::Create(SmallOptions());
  ASSERT_THAT(watched, IsOk());
  ASSERT_THAT(unwatched, IsOk());
  for (int i = 0; i < 400; ++i) {  // until after dusk, when pictures have noise
    const auto action = static_cast<Action>(i % 5);
    ASSERT_THAT((*watched)->Step(action), IsOk());
    ASSERT_THAT((*unwatched)->Step(action), IsOk());
    ASSERT_THAT((*watched)->Picture(i % 2 == 0 ? 36 : 90), IsOk());
  }
  EXPECT_EQ(*(*watched)->Picture(63), *(*unwatched)->Picture(63));
  EXPECT_EQ((*watched)->Picture(63)->size(), size_t{63} * 63 * 3);
}

TEST(PlaySession, TellsWhatWasUnlocked) {
  const auto session = PlaySession::Create(SmallOptions());
  ASSERT_THAT(session, IsOk());
  EXPECT_THAT((*session)->Panel(), Not(HasLine("+1")));
  // Sleeping until the player wakes up unlocks an achievement.
  for (int i = 0; i < 2000 && (*session)->world().episode_reward() < 0.5 && !(*session)->ended(); ++i) {
    ASSERT_THAT((*session)->Step(Action::kSleep), IsOk());
  }
  EXPECT_THAT((*session)->Panel(), HasLine("+1 wake up"));
  EXPECT_THAT((*session)->Summary(),
              AllOf(StartsWith("crafter, seed 7, episode 1: "), EndsWith("achievements: wake up")));
}

TEST(PlaySession, ADeadPlayerDoesNotActUntilTheNextEpisode) {
  const auto session = PlaySession::Create(SmallOptions());
  ASSERT_THAT(session, IsOk());
  for (int i = 0; i < 10000 && !(*session)->ended(); ++i) ASSERT_THAT((*session)->Step(Action::kNoop), IsOk());
  ASSERT_TRUE((*session)->ended());
  WorldEditor::State(const_cast<World*>(&(*session)->world())).player.inventory.fill(9);
  const std::vector<TextLine> panel = (*session)->Panel();
  EXPECT_THAT(panel, AllOf(HasLine("died"), HasLine("n: next episode")));
  for (const TextLine& line : panel) EXPECT_LE(line.text.size(), size_t{kTextColumns}) << line.text;
  EXPECT_THAT(PageRows({0, 0, "", panel}, kLeastColumns, kLeastRows), Contains(HasSubstr("n: next episode")));
  const int64_t steps = (*session)->world().step();
  ASSERT_THAT((*session)->Step(Action::kMoveLeft), IsOk());
  EXPECT_EQ((*session)->world().step(), steps);
  ASSERT_THAT((*session)->StartNextEpisode(), IsOk());
  EXPECT_FALSE((*session)->ended());
  EXPECT_EQ((*session)->world().episode(), 2);
  EXPECT_THAT((*session)->Panel(), Not(HasLine("died")));
}

TEST(PlaySession, PlaysVariantsAndRefusesTinyPictures) {
  PlaySession::Options options = SmallOptions();
  options.env = *EnvName::Parse("crafter:inventory=off,numbers=hard-x2");
  const auto session = PlaySession::Create(options);
  ASSERT_THAT(session, IsOk());
  EXPECT_THAT((*session)->Panel(), HasLine("crafter:numbers=hard-x2,inventory=off"));
  EXPECT_THAT((*session)->Picture(4), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("4")));
}

}  // namespace
}  // namespace craftfleet
