#include "deploy/cli/play/play_loop.h"

#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/deploy/cli/screen/fake_screen.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::Contains;
using testing::Field;
using testing::HasSubstr;

class PlayLoopTest : public testing::Test {
 protected:
  PlayLoopTest() {
    PlaySession::Options options;
    options.seed = 3;
    options.textures = Textures::BuiltIn();
    session_ = *PlaySession::Create(options);
  }
  // Returns the screen at the end.
  FakeScreen Play(const std::deque<Key>& keys, absl::Duration step_time = absl::InfiniteDuration()) {
    FakeScreen screen(keys, &clock_);
    EXPECT_THAT(PlayOnScreen(step_time, stop_, &clock_, session_.get(), &screen), IsOk());
    return screen;
  }

  FakeClock clock_;
  std::atomic<bool> stop_{false};
  std::unique_ptr<PlaySession> session_;
};

TEST_F(PlayLoopTest, EachKeyIsAStep) {
  const Position start = session_->world().player_position();
  Play({'a', kNoKey, kRightKey, 'x', '.'});
  EXPECT_EQ(session_->world().step(), 3);
  EXPECT_EQ(session_->world().player_position(), start) << "left and right again";
}

TEST_F(PlayLoopTest, InRealTimeTheLastKeyOfAStepCounts) {
  Play({'s', 'a', kNoKey, kNoKey, kNoKey, kNoKey}, absl::Milliseconds(300));
  EXPECT_EQ(session_->world().step(), 2) << "400 ms and 400 ms of waiting";
  EXPECT_EQ(session_->world().objects()[0].facing.x, -1);
}

TEST_F(PlayLoopTest, HelpPausesTheGame) {
  const FakeScreen screen = Play({'h', kNoKey, kNoKey, kNoKey}, absl::Milliseconds(100));
  EXPECT_EQ(session_->world().step(), 0);
  EXPECT_THAT(screen.shown().back().lines, Contains(Field(&TextLine::text, HasSubstr("place a table"))));
  Play({'h', 'a', '.'});
  EXPECT_EQ(session_->world().step(), 1) << "the first key leaves the help";
}

TEST_F(PlayLoopTest, EscapeQuitsAndSoDoesASignal) {
  Play({'.', kEscapeKey, '.'});
  EXPECT_EQ(session_->world().step(), 1);
  stop_ = true;
  EXPECT_TRUE(Play({'.'}).shown().empty());
  EXPECT_EQ(session_->world().step(), 1);
}

TEST_F(PlayLoopTest, ThePictureFillsTheRoomWithWholeCells) {
  const View view = Play({}).shown().back();
  EXPECT_EQ(view.width, 72) << "8 pixels for each of 9 cells";
  EXPECT_EQ(view.picture.size(), size_t{72} * 72 * 3);
}

TEST(PlayKeys, ReachEveryActionAndAreInTheHelp) {
  std::set<Action> actions;
  for (Key key = 1; key <= kCloseKey; ++key) {
    if (const auto action = ActionOfKey(key)) actions.insert(*action);
  }
  EXPECT_EQ(actions.size(), size_t{kNumActions});
  for (const TextLine& line : KeyHelp()) EXPECT_LE(line.text.size(), size_t{kTextColumns}) << line.text;
  EXPECT_EQ(ActionOfKey('n'), std::nullopt);
}

}  // namespace
}  // namespace craftfleet
