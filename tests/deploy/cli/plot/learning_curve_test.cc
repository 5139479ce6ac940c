#include "deploy/cli/plot/learning_curve.h"

#include <zlib.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "learner/run/score.h"
#include "learner/run/stats_log.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

std::vector<Episode> SampleEpisodes(int count) {
  std::vector<Episode> episodes;
  episodes.reserve(count);
  for (int i = 0; i < count; ++i) episodes.push_back(SampleEpisode(100 + i * 7 % 31, 0.1 * (i % 29) - 1));
  return episodes;
}

std::string StatsText(const std::vector<Episode>& episodes) {
  std::string text;
  for (const Episode& episode : episodes) text += FormatStatsLine(episode);
  return text;
}

TEST(CurveOfEpisodes, HasTheFiguresOfTheScoreBoardAfterEachEpisode) {
  const std::vector<Episode> episodes = SampleEpisodes(250);
  const LearningCurve curve = CurveOfEpisodes(episodes);
  ASSERT_EQ(curve.size(), 250U);
  ScoreBoard board;
  int64_t steps = 0;
  for (int i = 0; i < 250; ++i) {
    board.Add(episodes[i]);
    steps += episodes[i].length;
    EXPECT_EQ(curve[i].episodes, i + 1);
    EXPECT_EQ(curve[i].steps, steps);
    EXPECT_EQ(curve[i].reward, board.RecentReward());
    EXPECT_EQ(curve[i].score, board.Score());
  }
}

TEST(CurveOfEpisodes, TheRewardIsTheMeanOfTheLastHundred) {
  std::vector<Episode> episodes(100, SampleEpisode(10, 1));
  episodes.resize(150, SampleEpisode(10, 3));
  const LearningCurve curve = CurveOfEpisodes(episodes);
  EXPECT_DOUBLE_EQ(curve[49].reward, 1);
  EXPECT_DOUBLE_EQ(curve[149].reward, 2);
  EXPECT_EQ(curve[149].steps, 1500);
}

TEST(ReadRunCurve, ReadsAFolderOrItsFilePlainOrGzipped) {
  const TempFolder folder;
  const std::string text = StatsText(SampleEpisodes(120));
  ASSERT_THAT(CreateFolders(folder / "plain"), IsOk());
  ASSERT_THAT(WriteFileSynced(folder / "plain/stats.jsonl", text), IsOk());
  ASSERT_THAT(CreateFolders(folder / "small"), IsOk());
  const gzFile file = gzopen((folder / "small/stats.jsonl.gz").c_str(), "wb");
  ASSERT_EQ(gzwrite(file, text.data(), text.size()), static_cast<int>(text.size()));
  ASSERT_EQ(gzclose(file), Z_OK);

  for (const char* path : {"plain", "plain/", "plain/stats.jsonl", "small", "small/stats.jsonl.gz"}) {
    const auto curve = ReadRunCurve(folder / path);
    ASSERT_THAT(curve, IsOk()) << path;
    EXPECT_EQ(curve->size(), 120U);
    EXPECT_EQ(curve->back().score, CurveOfEpisodes(SampleEpisodes(120)).back().score);
  }
}

TEST(ReadRunCurve, NamesTheErrorOfARun) {
  const TempFolder folder;
  EXPECT_THAT(ReadRunCurve(folder.path()), StatusIs(absl::StatusCode::kNotFound, HasSubstr("it has no stats.jsonl")));
  EXPECT_THAT(ReadRunCurve(folder / "none"), StatusIs(absl::StatusCode::kNotFound, HasSubstr("/none")));
  ASSERT_THAT(WriteFileSynced(folder / "stats.jsonl", ""), IsOk());
  EXPECT_THAT(ReadRunCurve(folder.path()),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("no episode has finished yet")));
  ASSERT_THAT(WriteFileSynced(folder / "stats.jsonl", "{}\n"), IsOk());
  EXPECT_THAT(ReadRunCurve(folder.path()), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("stats.jsonl:1: ")));
}

absl::StatusOr<LearningCurve> ReadReference(const std::string& text) {
  const TempFolder folder;
  EXPECT_THAT(WriteFileSynced(folder / "table.csv", text), IsOk());
  return ReadReferenceCurve(folder / "table.csv");
}

TEST(ReadReferenceCurve, FindsItsColumnsAmongOthers) {
  const auto curve = ReadReference(
      "iter,steps,episodes,crafter_score_cum,ep_rew_mean100,losses\r\n"
      "1,4096,26,1.0045,1.25,\r\n"
      "2,8192,50,1.2387,1.34,0.5\r\n");
  ASSERT_THAT(curve, IsOk());
  ASSERT_EQ(curve->size(), 2U);
  EXPECT_EQ((*curve)[1].steps, 8192);
  EXPECT_EQ((*curve)[1].episodes, 50);
  EXPECT_EQ((*curve)[1].reward, 1.34);
  EXPECT_EQ((*curve)[1].score, 1.2387);
}

TEST(ReadReferenceCurve, NamesTheLineAndColumnThatAreWrong) {
  constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
  const std::string names = "episodes,steps,ep_rew_mean100,crafter_score_cum\n";
  EXPECT_THAT(ReadReference(""), StatusIs(kInvalid, HasSubstr("table.csv:1: no column \"episodes\"")));
  EXPECT_THAT(ReadReference("episodes,steps,reward\n"), StatusIs(kInvalid, HasSubstr("no column \"ep_rew_mean100\"")));
  EXPECT_THAT(ReadReference(names), StatusIs(kInvalid, HasSubstr("no line after")));
  EXPECT_THAT(ReadReference(names + "1,2,3,4\n1,2,x,4\n"),
              StatusIs(kInvalid, HasSubstr(":3: ep_rew_mean100 is \"x\", want a number")));
  EXPECT_THAT(ReadReference(names + "1,2,3\n"), StatusIs(kInvalid, HasSubstr(":2: crafter_score_cum is \"\"")));
}

}  // namespace
}  // namespace craftfleet
