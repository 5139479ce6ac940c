#include "learner/run/stats_log.h"

#include <cmath>
#include <sstream>
#include <string>
#include <vector>

#include <absl/strings/str_replace.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/crafter.h"
#include "common/io/files.h"
#include "learner/run/append_file.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

std::string RewardText(double reward) {
  const std::string line = FormatStatsLine(SampleEpisode(1, reward));
  const size_t start = line.find("\"reward\": ") + 10;
  return line.substr(start, line.find(',', start) - start);
}

TEST(StatsLine, MatchesPythonsJsonDumps) {
  Episode episode;
  episode.length = 163;
  episode.reward = 1.0776035110335536;
  for (int i = 0; i < kNumAchievements; ++i) episode.achievements[i] = i;
  EXPECT_EQ(FormatStatsLine(episode),
            "{\"length\": 163, \"reward\": 1.1, \"achievement_collect_coal\": 0, \"achievement_collect_diamond\": 1, "
            "\"achievement_collect_drink\": 2, \"achievement_collect_iron\": 3, \"achievement_collect_sapling\": 4, "
            "\"achievement_collect_stone\": 5, \"achievement_collect_wood\": 6, \"achievement_defeat_skeleton\": 7, "
            "\"achievement_defeat_zombie\": 8, \"achievement_eat_cow\": 9, \"achievement_eat_plant\": 10, "
            "\"achievement_make_iron_pickaxe\": 11, \"achievement_make_iron_sword\": 12, "
            "\"achievement_make_stone_pickaxe\": 13, \"achievement_make_stone_sword\": 14, "
            "\"achievement_make_wood_pickaxe\": 15, \"achievement_make_wood_sword\": 16, "
            "\"achievement_place_furnace\": 17, \"achievement_place_plant\": 18, \"achievement_place_stone\": 19, "
            "\"achievement_place_table\": 20, \"achievement_wake_up\": 21}\n");
}

// Texts printed by CPython 3.11: json.dumps(round(x, 1)).
TEST(StatsLine, RoundsRewardsLikePython) {
  std::istringstream cases(
      "0.05 0.1  0.15 0.1  0.25 0.2  0.35 0.3  0.45 0.5  0.75 0.8  0.85 0.8  0.95 0.9  1.05 1.1  1.25 1.2  2.675 2.7 "
      "9.95 9.9  10 10.0  123456.75 123456.8  21.049999999999997 21.0  -0.8999999999999999 -0.9  -0.25 -0.2 "
      "-0.05 -0.1  -0.04 -0.0  -0.0 -0.0  0 0.0");
  double reward = 0;
  std::string text;
  while (cases >> reward >> text) EXPECT_EQ(RewardText(reward), text) << reward;
}

TEST(StatsLine, RoundedRewardIsTheNumberThatIsPrinted) {
  EXPECT_EQ(RoundReward(1.0776035110335536), 1.1);
  EXPECT_EQ(RoundReward(0.25), 0.2);
  EXPECT_TRUE(std::signbit(RoundReward(-0.04)));
}

TEST(StatsLog, ReadsBackWhatWasAppended) {
  const TempFolder folder;
  AppendFile log = AppendFile::Open(folder / "stats.jsonl").value();
  log.Append(FormatStatsLine(SampleEpisode(100, 2.06)) + FormatStatsLine(SampleEpisode(10000, -0.9)));
  ASSERT_THAT(log.Flush(), IsOk());
  log.Append(FormatStatsLine(SampleEpisode(7, 0)));
  ASSERT_THAT(log.Flush(), IsOk());
  const std::vector<Episode> episodes = ReadStats(folder / "stats.jsonl");
  ASSERT_EQ(episodes.size(), 3U);
  EXPECT_EQ(episodes[0].length, 100);
  EXPECT_EQ(episodes[0].reward, 2.1);
  EXPECT_EQ(episodes[0].achievements, SampleEpisode(100, 0).achievements);
  EXPECT_EQ(episodes[1].length, 10000);
  EXPECT_EQ(episodes[1].reward, -0.9);
  EXPECT_EQ(episodes[2].length, 7);
}

// Such as one from a learner that was in the middle of a write when this one took over its run.
TEST(StatsLog, ALineOfAnotherLearnerIsCutOff) {
  const TempFolder folder;
  const std::string path = folder / "stats.jsonl";
  AppendFile log = AppendFile::Open(path).value();
  AppendFile other = AppendFile::Open(path).value();
  other.Append(FormatStatsLine(SampleEpisode(1, 0)) + FormatStatsLine(SampleEpisode(2, 0)));
  ASSERT_THAT(other.Flush(), IsOk());
  for (const int episode : {1, 2}) {
    log.Append(FormatStatsLine(SampleEpisode(episode, 0)));
    ASSERT_THAT(log.Flush(), IsOk());
  }
  EXPECT_EQ(ReadFile(path).value(), FormatStatsLine(SampleEpisode(1, 0)) + FormatStatsLine(SampleEpisode(2, 0)));
}

absl::Status ReadStatsText(const std::string& text) {
  const TempFolder folder;
  const std::string path = folder / "stats.jsonl";
  EXPECT_THAT(WriteFileSynced(path, text), IsOk());
  return VisitStats(path, static_cast<int64_t>(text.size()), [](const Episode& /*episode*/) {});
}

TEST(ReadStats, ErrorsNameTheLine) {
  const std::string good = FormatStatsLine(SampleEpisode(5, 1));
  ASSERT_THAT(ReadStatsText(good), IsOk());
  EXPECT_THAT(ReadStatsText(""), IsOk());
  const auto second_line = [&](absl::string_view from, absl::string_view to) {
    const std::string changed = absl::StrReplaceAll(good, {{from, to}});
    EXPECT_NE(changed, good);
    return ReadStatsText(good + changed);
  };
  constexpr auto kDataLoss = absl::StatusCode::kDataLoss;
  EXPECT_THAT(second_line("\n", ""), StatusIs(kDataLoss, HasSubstr("stats.jsonl:2: the line is incomplete")));
  EXPECT_THAT(second_line("}", ""), StatusIs(kDataLoss, HasSubstr(":2: not a JSON object")));
  EXPECT_THAT(second_line(": 5", ": \"5\""), StatusIs(kDataLoss, HasSubstr(":2: \"length\" is \"5\", want 1..")));
  EXPECT_THAT(second_line(": 5", ": 0"), StatusIs(kDataLoss, HasSubstr("\"length\" is 0")));
  EXPECT_THAT(second_line("1.0", "null"), StatusIs(kDataLoss, HasSubstr("\"reward\"")));
  EXPECT_THAT(second_line("_eat_cow\": 0", "_eat_cow\": -1"),
              StatusIs(kDataLoss, HasSubstr("\"achievement_eat_cow\" is -1")));
  EXPECT_THAT(second_line("eat_cow", "eat_crow"), StatusIs(kDataLoss, HasSubstr("no \"achievement_eat_cow\"")));
  EXPECT_THAT(second_line("}", ", \"x\": 1}"), StatusIs(kDataLoss, HasSubstr("has 25 keys, want 24")));
  EXPECT_THAT(ReadStatsText("\n"), StatusIs(kDataLoss, HasSubstr(":1: not a JSON object")));
}

TEST(ReadStats, AFileThatCannotBeReadIsNotTakenForAnEmptyOne) {
  const TempFolder folder;
  const auto error = [](const std::string& path) {
    return std::string(VisitStats(path, 1, [](const Episode& /*episode*/) {}).message());
  };
  EXPECT_EQ(error(folder.path()), "cannot read " + folder.path() + ": Is a directory");
  EXPECT_EQ(error(folder / "none"), "cannot open " + folder / "none" + ": No such file or directory");
}

TEST(StatsLog, ReadsOnlyTheGivenLength) {
  const TempFolder folder;
  const std::string first = FormatStatsLine(SampleEpisode(1, 1));
  const std::string path = folder / "stats.jsonl";
  ASSERT_THAT(WriteFileSynced(path, first + "what comes after"), IsOk());
  const auto size = static_cast<int64_t>(first.size());
  int episodes = 0;
  const auto count = [&episodes](const Episode& /*episode*/) { ++episodes; };
  EXPECT_THAT(VisitStats(path, size, count), IsOk());
  EXPECT_EQ(episodes, 1);
  EXPECT_THAT(VisitStats(path, 0, count), IsOk());
  EXPECT_EQ(episodes, 1);
  EXPECT_THAT(VisitStats(path, size - 1, count),
              StatusIs(absl::StatusCode::kDataLoss, testing::HasSubstr("the line is incomplete")));
  EXPECT_THAT(VisitStats(path, 1000, count),
              StatusIs(absl::StatusCode::kDataLoss, testing::HasSubstr("the checkpoint expects 1000")));
}

}  // namespace
}  // namespace craftfleet
