#include "learner/page/page.h"

#include <random>
#include <string>
#include <vector>

#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "envserver/world/world.h"
#include "learner/run/score.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;
using testing::SizeIs;

// The published figures inside the page.
nlohmann::json References() {
  const absl::string_view page = PageTemplate();
  const absl::string_view begin = R"(id="references">)";
  const size_t at = page.find(begin) + begin.size();
  return nlohmann::json::parse(page.substr(at, page.find("</script>", at) - at));
}

double ScoreOf(const std::string& player) {
  const nlohmann::json rates = References()["rates"];
  AchievementPercentages percentages;
  for (int i = 0; i < kNumAchievements; ++i) percentages[i] = rates[std::string(kAchievementNames[i])][player];
  return CrafterScore(percentages);
}

TEST(Page, IsOneFileWithTwoScripts) {
  EXPECT_THAT(std::string(PageTemplate()), Not(HasSubstr("{{")));
  const std::vector<std::string> scripts = absl::StrSplit(PageTemplate(), "<script>");
  EXPECT_THAT(scripts, SizeIs(3)) << "Chart.js and the page's own";
  EXPECT_THAT(scripts[1], HasSubstr("Chart.js v3"));
}

// The scores that were published with the rates: 4.6 and 1.6 (Hafner 2021, whose rates have one decimal).
TEST(References, HaveThePublishedScores) {
  EXPECT_NEAR(ScoreOf("ppo"), 4.6, 0.1);
  EXPECT_NEAR(ScoreOf("random"), 1.6, 0.1);
}

// The page's figures are of ten seeds with a million steps each. Of 200,000 steps, some 1,190 episodes, a rate has a
// standard deviation of 1.5 percentage points at most.
TEST(References, RandomPlayIsThatOfThisEngine) {
  std::mt19937_64 random(1);
  std::uniform_int_distribution<int> action(0, kNumActions - 1);
  World world = World::Create(WorldOptions(), /*seed=*/1).value();
  ScoreBoard board;
  for (int step = 0; step < 200'000; ++step) {
    if (world.Step(static_cast<Action>(action(random))).end == StepEnd::kNone) continue;
    Episode episode;
    for (int i = 0; i < kNumAchievements; ++i) episode.achievements[i] = world.player().achievements[i];
    board.Add(episode);
    world.Reset();
  }
  const nlohmann::json rates = References()["rates"];
  for (int i = 0; i < kNumAchievements; ++i) {
    EXPECT_NEAR(board.SuccessPercentages()[i], rates[std::string(kAchievementNames[i])]["random"].get<double>(), 6)
        << kAchievementNames[i];
  }
}

}  // namespace
}  // namespace craftfleet
