#include "learner/run/score.h"

#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/io/files.h"
#include "learner/run/stats_log.h"
#include "tests/fakes/test_paths.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

using testing::DoubleNear;

constexpr double kTolerance = 1e-12;  // the golden percentages were computed in another order of operations

struct GoldenEpisode {
  Episode episode;
  nlohmann::json after;
};

std::vector<GoldenEpisode> ReadGolden() {
  const auto golden = nlohmann::json::parse(ReadFile(SourcePath("tests/data/agents/score.json")).value());
  EXPECT_EQ(golden["achievement_order"].size(), kAchievementNames.size());
  for (int i = 0; i < kNumAchievements; ++i) {
    EXPECT_EQ(golden["achievement_order"][i], std::string(kAchievementNames[i]));
  }
  std::vector<GoldenEpisode> episodes;
  for (const auto& row : golden["episodes"]) {
    GoldenEpisode golden_episode{Episode{}, row["after"]};
    golden_episode.episode.length = row["length"];
    golden_episode.episode.reward = row["reward"];
    golden_episode.episode.achievements = row["achievement_counts"];
    episodes.push_back(golden_episode);
  }
  return episodes;
}

TEST(ScoreBoard, MatchesTheGoldenFiguresAfterEachEpisode) {
  ScoreBoard board;
  const std::vector<GoldenEpisode> golden = ReadGolden();
  ASSERT_EQ(golden.size(), 6U);
  for (const auto& [episode, after] : golden) {
    board.Add(episode);
    const AchievementPercentages percentages = board.SuccessPercentages();
    for (int i = 0; i < kNumAchievements; ++i) {
      EXPECT_NEAR(percentages[i], after["percentages"][i].get<double>(), 1e2 * kTolerance) << kAchievementNames[i];
    }
    EXPECT_NEAR(board.Score(), after["score"].get<double>(), 1e2 * kTolerance);
    EXPECT_NEAR(board.MeanReward(), after["reward_mean"].get<double>(), kTolerance);
    EXPECT_NEAR(board.RecentReward(), after["reward_mean"].get<double>(), kTolerance);
    EXPECT_NEAR(board.MeanLength(), after["length_mean"].get<double>(), 1e3 * kTolerance);
    EXPECT_NEAR(board.RecentLength(), after["length_mean"].get<double>(), 1e3 * kTolerance);
  }
}

TEST(ScoreBoard, RebuiltFromStatsItIsEqual) {
  ScoreBoard board;
  ScoreBoard again;
  for (int i = 0; i < 250; ++i) {
    const Episode episode = SampleEpisode(100 + i * 7 % 31, 0.37 * (i % 29) - 1);
    board.Add(episode);
    again.Add(ParseStatsLine(FormatStatsLine(episode)).value());
  }
  EXPECT_EQ(again.episodes(), 250);
  EXPECT_EQ(again.SuccessPercentages(), board.SuccessPercentages());
  EXPECT_EQ(again.Score(), board.Score());
  EXPECT_EQ(again.MeanReward(), board.MeanReward());
  EXPECT_EQ(again.RecentReward(), board.RecentReward());
  EXPECT_EQ(again.RecentLength(), board.RecentLength());
}

TEST(ScoreBoard, RecentMeansCoverTheLastHundred) {
  ScoreBoard board;
  for (int i = 0; i < 100; ++i) board.Add(SampleEpisode(1000, 10));
  for (int i = 0; i < 50; ++i) board.Add(SampleEpisode(200, 2));
  EXPECT_THAT(board.RecentReward(), DoubleNear(6, kTolerance));
  EXPECT_EQ(board.RecentLength(), 600);
  for (int i = 0; i < 50; ++i) board.Add(SampleEpisode(200, 2));
  EXPECT_EQ(board.RecentReward(), 2);
  EXPECT_EQ(board.RecentLength(), 200);
  EXPECT_THAT(board.MeanReward(), DoubleNear(6, kTolerance));
  EXPECT_EQ(board.MeanLength(), 600);
}

TEST(ScoreBoard, CountsAnAchievementOncePerEpisode) {
  ScoreBoard board;
  Episode episode = SampleEpisode(1, 0);
  episode.achievements = {};
  board.Add(episode);
  EXPECT_EQ(board.Unlocked(), 0);
  EXPECT_EQ(board.Score(), 0);
  episode.achievements[3] = 5;
  board.Add(episode);
  EXPECT_EQ(board.Unlocked(), 1);
  EXPECT_EQ(board.SuccessPercentages()[3], 50);
}

TEST(ScoreBoard, IsZeroBeforeTheFirstEpisode) {
  const ScoreBoard board;
  EXPECT_EQ(board.Score(), 0);
  EXPECT_EQ(board.MeanReward(), 0);
  EXPECT_EQ(board.RecentLength(), 0);
}

TEST(CrafterScore, IsTheGeometricMeanOfOnePlusPercentages) {
  AchievementPercentages percentages;
  percentages.fill(100);
  EXPECT_THAT(CrafterScore(percentages), DoubleNear(100, 1e-10));
  percentages.fill(0);
  percentages[0] = 100;
  EXPECT_THAT(CrafterScore(percentages), DoubleNear(0.2334044670569, 1e-10));  // 101^(1/22) - 1
}

}  // namespace
}  // namespace craftfleet
