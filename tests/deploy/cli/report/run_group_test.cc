#include "deploy/cli/report/run_group.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "deploy/cli/report/curve_spread.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;

RunRecord SampleRun(const std::string& folder, const std::string& identity, int seed, bool complete, double score = 0) {
  RunRecord run;
  run.folder = folder;
  run.identity = identity;
  run.config.set_seed(seed);
  run.config.set_steps(1000);
  run.steps = complete ? 1000 : 500;
  run.complete = complete;
  run.training.episodes = 1;
  run.training.score = score;
  return run;
}

TEST(SpreadOf, IsMeanAndSampleDeviation) {
  const Spread spread = SpreadOf({1, 2, 6});
  EXPECT_EQ(spread.n, 3);
  EXPECT_DOUBLE_EQ(spread.mean, 3);
  EXPECT_DOUBLE_EQ(*spread.deviation, std::sqrt(7));  // ((1-3)^2 + (2-3)^2 + (6-3)^2) / 2
}

TEST(SpreadOf, OneValueHasNoDeviationAndNoneNoMean) {
  EXPECT_EQ(SpreadOf({4}).mean, 4);
  EXPECT_FALSE(SpreadOf({4}).deviation.has_value());
  EXPECT_EQ(SpreadOf({}).n, 0);
}

TEST(FormatSpread, HasOneDecimal) {
  EXPECT_EQ(FormatSpread(SpreadOf({1, 2, 6}), "+-"), "3.0 +- 2.6");
  EXPECT_EQ(FormatSpread(SpreadOf({4}), "+-"), "4.0");
  EXPECT_EQ(FormatSpread(SpreadOf({}), "+-"), "-");
}

TEST(GroupRuns, SeparatesConfigurationsAndUnfinishedRuns) {
  const std::vector<RunRecord> runs = {SampleRun("r1", "a", 2, true), SampleRun("r2", "b", 1, true),
                                       SampleRun("r3", "a", 1, true), SampleRun("r4", "a", 3, false)};
  const auto groups = GroupRuns(runs);
  ASSERT_EQ(groups.size(), 2U);
  EXPECT_THAT(groups.at("a").complete, ElementsAre(&runs[2], &runs[0]));
  EXPECT_THAT(groups.at("a").incomplete, ElementsAre(&runs[3]));
  EXPECT_THAT(groups.at("b").complete, ElementsAre(&runs[1]));
}

TEST(GroupRuns, CountsASeedOnceTheCompleteRunBeforeOthers) {
  const std::vector<RunRecord> runs = {SampleRun("r1", "a", 1, false), SampleRun("r2", "a", 1, true),
                                       SampleRun("r3", "a", 1, true)};
  const RunGroup group = GroupRuns(runs).at("a");
  EXPECT_THAT(group.complete, ElementsAre(&runs[1]));
  EXPECT_TRUE(group.incomplete.empty());
  EXPECT_THAT(group.repeated, ElementsAre(&runs[2], &runs[0]));
}

TEST(RunGroup, AveragesCompleteRunsThatHaveTheMeasure) {
  std::vector<RunRecord> runs = {SampleRun("r1", "a", 1, true, 2), SampleRun("r2", "a", 2, true, 4),
                                 SampleRun("r3", "a", 3, false, 90)};
  runs[1].eval_sampled.episodes = 5;
  runs[1].eval_sampled.score = 7;
  const RunGroup group = GroupRuns(runs).at("a");
  EXPECT_EQ(group.Over(MeasureNamed("train").value).mean, 3);
  EXPECT_EQ(group.Over(MeasureNamed("train").value).n, 2);
  EXPECT_EQ(group.Over(MeasureNamed("eval").value).mean, 7);
  EXPECT_EQ(group.Over(MeasureNamed("eval").value).n, 1);
  EXPECT_EQ(group.Over(MeasureNamed("final").value).n, 0);
}

TEST(RunGroup, ScoresAtAMilestoneAreOfRunsThatGotThere) {
  std::vector<RunRecord> runs = {SampleRun("r1", "a", 1, true), SampleRun("r2", "a", 2, false)};
  runs[0].curve = {{1, 300, 0, 5}, {2, 450, 0, 6}, {3, 900, 0, 8}};
  runs[1].curve = {{1, 400, 0, 2}};
  const RunGroup group = GroupRuns(runs).at("a");
  EXPECT_EQ(group.ScoresAt(500).mean, 4);  // 6 and 2
  EXPECT_EQ(group.ScoresAt(500).n, 2);
  EXPECT_EQ(group.ScoresAt(900).mean, 8);
  EXPECT_EQ(group.ScoresAt(900).n, 1);
  EXPECT_EQ(group.ScoresAt(100).n, 0);
  EXPECT_EQ(group.ScoresAt(1001).n, 0);
}

TEST(SpreadOfCurves, HasTheLastPointOfEveryRunAtEachPlace) {
  std::vector<RunRecord> runs = {SampleRun("r1", "a", 1, true), SampleRun("r2", "a", 2, true)};
  runs[0].curve = {{9, 100, 1, 1}, {10, 200, 2, 3}, {11, 800, 4, 5}};
  runs[1].curve = {{10, 300, 8, 7}};
  const std::vector<CurveSpread> curve = SpreadOfCurves({&runs[0], &runs[1]}, 1000);
  ASSERT_EQ(curve.size(), 141U);  // steps 300, 305, ..., 1000: from where both have ten episodes
  EXPECT_EQ(curve[0].steps, 300);
  EXPECT_EQ(curve[0].score.mean, 5);   // 3 and 7
  EXPECT_EQ(curve[0].reward.mean, 5);  // 2 and 8
  EXPECT_EQ(curve[140].steps, 1000);
  EXPECT_EQ(curve[140].score.mean, 6);
  EXPECT_DOUBLE_EQ(*curve[140].score.deviation, std::sqrt(2));
}

}  // namespace
}  // namespace craftfleet
