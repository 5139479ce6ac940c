#include "learner/ppo/distillation/goals.h"

#include <cstdint>

#include <gtest/gtest.h>

#include "tests/agent/golden_agent.h"

namespace craftfleet {
namespace {

const char kGolden[] = "achievement_distillation.json";

TEST(Goals, AnEpisodesGoalsMatchTheGolden) {
  const nlohmann::json golden = testing::ReadGolden(kGolden)["goals"];
  ASSERT_GE(golden.size(), 3U);
  for (const nlohmann::json& episode : golden) {
    const auto unlocked = episode["unlocked"].get<std::vector<uint8_t>>();
    const std::vector<int> goals = GoalSteps(unlocked);
    EXPECT_EQ(goals, episode["goals"].get<std::vector<int>>());
    for (size_t t = 0; t < unlocked.size(); ++t) {
      const FramePair next = NextGoal(goals, static_cast<int>(unlocked.size()), static_cast<int>(t));
      EXPECT_EQ(next.before, episode["anchors"][t][0].get<int>()) << t;
      EXPECT_EQ(next.after, episode["anchors"][t][1].get<int>()) << t;
    }
  }
}

TEST(Goals, WholeEpisodesMatchTheGolden) {
  const nlohmann::json golden = testing::ReadGolden(kGolden)["episodes"]["lanes"];
  ASSERT_GE(golden.size(), 3U);
  for (const nlohmann::json& lane : golden) {
    std::vector<StepRange> expected;
    for (const nlohmann::json& range : lane["episodes"]) expected.push_back({range[0], range[1]});
    EXPECT_EQ(WholeEpisodes(lane["is_start"].get<std::vector<uint8_t>>()), expected);
  }
}

}  // namespace
}  // namespace craftfleet
