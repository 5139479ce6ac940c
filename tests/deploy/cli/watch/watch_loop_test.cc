#include "deploy/cli/watch/watch_loop.h"

#include <deque>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/deploy/cli/screen/fake_screen.h"
#include "tests/deploy/cli/watch/watched_game.h"
#include "tests/fakes/sample_policy.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

class WatchLoopTest : public testing::Test {
 protected:
  WatchLoopTest() {
    options_.speed = 10;
    options_.agent = [this] { return WatchedAgent{absl::StrCat("agent ", ++agents_), policy_}; };
  }
  // The second line of each view: "seed 5, episode 1, step 0".
  std::vector<std::string> Watch(const std::deque<Key>& keys, int length = 40) {
    FakeScreen screen(keys, &clock_);
    EXPECT_THAT(WatchOnScreen(options_, WatchedOptions(length), stop_, &clock_, &screen), IsOk());
    views_ = screen.shown();
    std::vector<std::string> lines;
    for (const View& view : views_) lines.push_back(view.lines[1].text);
    return lines;
  }

  const std::shared_ptr<const Policy> policy_ = SamplePolicy(1);
  FakeClock clock_;
  const std::atomic<bool> stop_{false};
  WatchOptions options_;
  int agents_ = 0;
  std::vector<View> views_;
};

TEST_F(WatchLoopTest, PlaysAStepAfterEachInterval) {
  const absl::Time start = clock_.Now();
  EXPECT_EQ(Watch({kNoKey, kNoKey, kNoKey}).back(), "seed 5, episode 1, step 3");
  EXPECT_EQ(clock_.Now() - start, absl::Milliseconds(300));
}

TEST_F(WatchLoopTest, KeysDoNotHurryTheGame) {
  EXPECT_EQ(Watch({'h', 'h', 'x', 'x'}).back(), "seed 5, episode 1, step 0");
}

TEST_F(WatchLoopTest, PauseHoldsTheGameAndPointPlaysOneStep) {
  EXPECT_EQ(Watch({' ', kNoKey, kNoKey, kNoKey}).back(), "seed 5, episode 1, step 0");
  EXPECT_THAT(views_.back().lines[0].text, StartsWith("PAUSED agent"));
  EXPECT_EQ(Watch({'.', kNoKey, '.', kNoKey}).back(), "seed 5, episode 1, step 2");
  EXPECT_EQ(Watch({' ', ' ', kNoKey}).back(), "seed 5, episode 1, step 1");
}

TEST_F(WatchLoopTest, KeysChooseTheEpisode) {
  EXPECT_EQ(Watch({kNoKey, 'n'}).back(), "seed 5, episode 2, step 0");
  EXPECT_EQ(Watch({kNoKey, 'n', 'n', 'b'}).back(), "seed 5, episode 2, step 0");
  EXPECT_EQ(Watch({'b'}).back(), "seed 5, episode 1, step 0");
  EXPECT_EQ(Watch({kNoKey, kNoKey, 'r'}).back(), "seed 5, episode 1, step 0");
}

TEST_F(WatchLoopTest, AnEndedEpisodeStaysForTwoSecondsThenTheNextBeginsWithTheNextAgent) {
  std::deque<Key> keys = {kNoKey, kNoKey};  // two steps end it
  keys.insert(keys.end(), 9, kNoKey);       // 9 x 200 ms
  EXPECT_EQ(Watch(keys, 2).back(), "seed 5, episode 1, step 2");
  keys.push_back(kNoKey);
  agents_ = 0;
  EXPECT_EQ(Watch(keys, 2).back(), "seed 5, episode 2, step 0");
  EXPECT_EQ(views_.back().lines[0].text, "agent 2");
}

TEST_F(WatchLoopTest, TheKeyForAttentionDoesNothingWithoutAttention) {
  EXPECT_EQ(Watch({'a', kNoKey}).back(), "seed 5, episode 1, step 1");
  options_.attention = AttentionChoice();
  FakeScreen screen({}, &clock_);
  EXPECT_THAT(WatchOnScreen(options_, WatchedOptions(), stop_, &clock_, &screen),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("no attention")));
}

TEST(HandleWatchKey, ChangesTheSpeedWithinItsRange) {
  WatchState state;
  for (int i = 0; i < 20; ++i) HandleWatchKey('+', 1, &state);
  EXPECT_EQ(state.speed, 256);
  for (int i = 0; i < 20; ++i) HandleWatchKey('-', 1, &state);
  EXPECT_EQ(state.speed, 0.25);
}

}  // namespace
}  // namespace craftfleet
