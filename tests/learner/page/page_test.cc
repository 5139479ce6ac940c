#include "learner/page/page.h"

#include <zlib.h>

#include <random>

#include <absl/strings/match.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "envserver/world/world.h"

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
  EXPECT_THAT(ScriptsOf(PageTemplate()), SizeIs(2)) << "Chart.js and the page's own";
  EXPECT_TRUE(absl::StrContains(ScriptsOf(PageTemplate())[0], "Chart.js v3"));
}

TEST(Page, GzipKeepsEveryByte) {
  const std::string packed = Gzip(PageTemplate());
  std::string text(PageTemplate().size() + 1, '\0');
  z_stream stream = {};
  ASSERT_EQ(inflateInit2(&stream, 15 + 16), Z_OK);
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data()));
  stream.avail_in = static_cast<uInt>(packed.size());
  stream.next_out = reinterpret_cast<Bytef*>(text.data());
  stream.avail_out = static_cast<uInt>(text.size());
  EXPECT_EQ(inflate(&stream, Z_FINISH), Z_STREAM_END);
  text.resize(stream.total_out);
  inflateEnd(&stream);
  EXPECT_EQ(text, PageTemplate());
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
