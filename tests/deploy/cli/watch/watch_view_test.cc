#include "deploy/cli/watch/watch_view.h"

#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/crafter.h"
#include "deploy/cli/screen/game_text.h"
#include "tests/deploy/cli/watch/watched_game.h"
#include "tests/fakes/sample_policy.h"
#include "tests/fakes/status_matchers.h"
#include "tests/golden/world_editor.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

TEST(DescribeMoment, ShowsTheStateAndEveryAction) {
  const auto game = AgentGame::Create(WatchedOptions(), SamplePolicy(1), 2);
  ASSERT_THAT(game, IsOk());
  ASSERT_THAT((*game)->Step(), IsOk());
  const std::vector<TextLine> lines = DescribeMoment("ppo_cnn, 100 steps", **game);
  EXPECT_EQ(lines[0].text, "ppo_cnn");
  EXPECT_EQ(lines[1].text, "100 steps");
  EXPECT_EQ(lines[2].text, "seed 5, episode 2, step 1");
  EXPECT_THAT(lines[3].text, AllOf(StartsWith("reward 0.0 (+0.0), value "), HasSubstr(".")));
  EXPECT_EQ(lines[4].text, "health 9 food 9 drink 9 energy 9");
  int chosen = 0;
  for (int action = 0; action < kNumActions; ++action) {
    const TextLine& line = lines[5 + action];
    EXPECT_THAT(line.text, HasSubstr(std::string(kActionNames[action])));
    EXPECT_EQ(line.bar, (*game)->decision().odds.probs[action]);
    if (line.text[0] != '>') continue;
    ++chosen;
    EXPECT_EQ(action, static_cast<int>((*game)->decision().action));
  }
  EXPECT_EQ(chosen, 1);
}

TEST(DescribeMoment, ShowsEverythingThatThePlayerHasBelowTheActions) {
  const auto game = AgentGame::Create(WatchedOptions(), SamplePolicy(1), 1);
  ASSERT_THAT(game, IsOk());
  auto& inventory = WorldEditor::State(const_cast<World*>(&(*game)->world())).player.inventory;
  const std::string title = "achievement_distillation, 1,003,520 steps";
  const std::vector<TextLine> before = DescribeMoment(title, **game);
  inventory.fill(9);
  const std::vector<TextLine> lines = DescribeMoment(title, **game);
  ASSERT_GT(lines.size(), before.size());
  EXPECT_EQ(lines[5].text, before[5].text) << "the actions have moved";
  EXPECT_LE(lines.size(), 28U);
  for (const TextLine& line : lines) EXPECT_LE(line.text.size(), size_t{kTextColumns}) << line.text;
  std::string items;
  for (size_t i = before.size(); i < lines.size(); ++i) items += lines[i].text + "; ";
  for (int i = static_cast<int>(Item::kSapling); i < kNumItems; ++i) {
    EXPECT_THAT(items, HasSubstr("9 " + Words(kItemNames[i])));
  }
}

TEST(DrawMoment, DarkensWhereTheAgentDoesNotLook) {
  AgentGame::Options options = WatchedOptions();
  options.frame_size = 72;
  const auto game = AgentGame::Create(options, SamplePolicy(1, 1, "oc_ca"), 1);
  ASSERT_THAT(game, IsOk());
  const auto plain = DrawMoment("", {100, 90}, std::nullopt, game->get());
  const auto overlaid = DrawMoment("", {100, 90}, AttentionChoice(), game->get());
  ASSERT_THAT(plain, IsOk());
  ASSERT_THAT(overlaid, IsOk());
  EXPECT_EQ(plain->width, 90);
  EXPECT_EQ(overlaid->picture.size(), plain->picture.size());
  EXPECT_NE(overlaid->picture, plain->picture);
}

}  // namespace
}  // namespace craftfleet
