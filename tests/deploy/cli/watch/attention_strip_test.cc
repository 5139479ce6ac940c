#include "deploy/cli/watch/attention_strip.h"

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/deploy/cli/watch/watched_game.h"
#include "tests/fakes/sample_policy.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

constexpr int kFrame = 72;

// Attention planted on one patch of a grey picture.
StripColumn Planted(const PatchGrid& patches, int patch) {
  StripColumn column;
  column.step = 7;
  column.picture.assign(size_t{3} * kStripPicture * kStripPicture, '\x60');
  column.patches = patches;
  column.weights.assign(patches.count(), 0.0F);
  column.weights[patch] = 0.5F;
  return column;
}

// Whether the second row shows attention at a pixel of the first column's frame.
bool Lit(const StripPicture& strip, int frame_x, int frame_y) {
  const int x = kStripGap + (2 * frame_x + 1) * kStripPicture / (2 * kFrame);
  const int y = 2 * kStripGap + kStripPicture + (2 * frame_y + 1) * kStripPicture / (2 * kFrame);
  const auto* pixel = reinterpret_cast<const uint8_t*>(&strip.pixels[size_t{3} * (y * strip.width + x)]);
  return pixel[0] > pixel[2] + 20;  // highlighted pixels are more red than blue
}

TEST(DrawStrip, ShowsTheFrameAboveAndPlantedAttentionBelow) {
  const PatchGrid patches = {kFrame, 8, 8};  // 9 x 9, without overlap
  const StripPicture strip = DrawStrip({Planted(patches, 9 * 2 + 4), Planted(patches, 0)});
  EXPECT_EQ(strip.width, 2 * (kStripPicture + kStripGap) + kStripGap);
  EXPECT_EQ(strip.height, 2 * kStripPicture + 3 * kStripGap + kStripLabel);
  ASSERT_EQ(strip.pixels.size(), size_t{3} * strip.width * strip.height);
  EXPECT_EQ(strip.pixels.substr(size_t{3} * (kStripGap * strip.width + kStripGap), 3), "\x60\x60\x60") << "unchanged";
  for (int x = 0; x < 9; ++x) {
    for (int y = 0; y < 9; ++y) EXPECT_EQ(Lit(strip, 8 * x + 4, 8 * y + 4), x == 4 && y == 2) << x << " " << y;
  }
}

TEST(DrawStrip, OverlappingPatchesAreSpread) {
  const PatchGrid patches = {kFrame, 16, 8};  // 8 x 8, each covers 2 x 2 squares
  const StripPicture spread = DrawStrip({Planted(patches, 8 * 3 + 3)});
  EXPECT_TRUE(Lit(spread, 24, 24));
  EXPECT_TRUE(Lit(spread, 39, 39));
  EXPECT_FALSE(Lit(spread, 23, 24));
  EXPECT_FALSE(Lit(spread, 40, 40));
}

TEST(ChooseSteps, PrefersAchievementsAndFillsUpEvenly) {
  EXPECT_THAT(ChooseSteps({5, 9, 70}, 100, 3), ElementsAre(5, 9, 70));
  EXPECT_THAT(ChooseSteps({5, 9, 70, 80}, 100, 3), ElementsAre(5, 9, 70));
  EXPECT_THAT(ChooseSteps({33}, 100, 4), ElementsAre(0, 25, 33, 50));
  EXPECT_THAT(ChooseSteps({}, 100, 4), ElementsAre(0, 25, 50, 75));
  EXPECT_THAT(ChooseSteps({}, 2, 6), ElementsAre(0, 1)) << "there are no more";
}

TEST(PlayOutline, CanBeStopped) {
  const auto game = AgentGame::Create(WatchedOptions(), SamplePolicy(1), 1);
  ASSERT_THAT(game, IsOk());
  const StepListener ignore = [](int64_t) {};
  EXPECT_THAT(PlayOutline(std::atomic<bool>{true}, ignore, game->get()),
              StatusIs(absl::StatusCode::kCancelled, HasSubstr("stopped")));
}

TEST(AttentionStrip, EachStepIsReported) {
  const std::shared_ptr<const Policy> policy = SamplePolicy(1);
  const auto game = AgentGame::Create(WatchedOptions(3), policy, 1);
  ASSERT_THAT(game, IsOk());
  const std::atomic<bool> stop{false};
  std::vector<int64_t> reported;
  const StepListener listener = [&reported](int64_t steps) { reported.push_back(steps); };
  EXPECT_THAT(PlayOutline(stop, listener, game->get()), IsOk());
  EXPECT_THAT(reported, ElementsAre(1, 2, 3));
  ASSERT_THAT((*game)->Start(policy, 1), IsOk());
  EXPECT_THAT(TakeColumns({9}, AttentionChoice(), stop, listener, game->get()).status(), IsOk());
  EXPECT_THAT(reported, ElementsAre(1, 2, 3, 1, 2, 3));
}

}  // namespace
}  // namespace craftfleet
