#include "deploy/cli/plot/curve_chart.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;

NamedCurve Curve(const std::string& name, const std::vector<int64_t>& steps) {
  NamedCurve curve = {name, {}};
  for (const int64_t step : steps) curve.curve.push_back({step / 100, step, 0.001 * step, 0.002 * step});
  return curve;
}

TEST(ShortNames, DistinguishRunsWithoutTheirCommonFolders) {
  EXPECT_THAT(ShortNames({"runs/a/seed1", "runs/a/seed2/"}), ElementsAre("seed1", "seed2"));
  EXPECT_THAT(ShortNames({"/runs/a/seed1", "/runs/b/seed1/stats.jsonl.gz"}), ElementsAre("a/seed1", "b/seed1"));
  EXPECT_THAT(ShortNames({"runs/first/stats.jsonl"}), ElementsAre("first"));
  EXPECT_THAT(ShortNames({"stats.jsonl"}), ElementsAre("stats.jsonl"));
  EXPECT_THAT(ShortNames({"runs/a", "runs/a"}), ElementsAre("a", "a"));
  EXPECT_THAT(ShortNames({"runs", "runs/a"}), ElementsAre("runs", "runs/a"));
  EXPECT_THAT(ShortNames({}), ElementsAre());
}

TEST(CurvePanels, ShowRewardAndScoreOverSteps) {
  const auto panels = CurvePanels({Curve("seed1", {1000, 2000, 3000})}, {});
  ASSERT_EQ(panels.size(), 2U);
  ASSERT_EQ(panels[0].lines.size(), 1U);
  EXPECT_EQ(panels[0].lines[0].name, "seed1");
  ASSERT_EQ(panels[0].lines[0].points.size(), 3U);
  EXPECT_EQ(panels[0].lines[0].points[2].x, 3000);
  EXPECT_EQ(panels[0].lines[0].points[2].y, 3);
  EXPECT_EQ(panels[1].lines[0].points[2].y, 6);
  EXPECT_EQ(panels[0].lines[0].stroke.dash, 0);
}

TEST(CurvePanels, BeginAtTenEpisodesIfThereAreSoMany) {
  const auto panels = CurvePanels({Curve("long", {900, 999, 1000, 1100}), Curve("short", {100, 300})}, {});
  ASSERT_EQ(panels[0].lines[0].points.size(), 2U);
  EXPECT_EQ(panels[0].lines[0].points[0].x, 1000);
  ASSERT_EQ(panels[0].lines[1].points.size(), 1U);
  EXPECT_EQ(panels[0].lines[1].points[0].x, 300);
}

TEST(CurvePanels, DrawReferencesGreyAndDashedBeneathTheRunsUpToTheirEnd) {
  const auto panels = CurvePanels({Curve("seed1", {1000, 2500}), Curve("seed2", {1000, 2000})},
                                  {Curve("old", {1000, 2000, 3000}), Curve("long", {4000, 5000})});
  for (const ChartPanel& panel : panels) {
    ASSERT_EQ(panel.lines.size(), 4U);
    EXPECT_EQ(panel.lines[0].name, "seed1");
    EXPECT_EQ(panel.lines[0].stroke.dash, 0);
    EXPECT_EQ(panel.lines[2].name, "old");
    EXPECT_EQ(panel.lines[2].points.size(), 2U);
    EXPECT_EQ(panel.lines[3].points.size(), 1U);
    for (const int reference : {2, 3}) {
      const Stroke& stroke = panel.lines[reference].stroke;
      EXPECT_GT(stroke.dash, 0);
      EXPECT_EQ(stroke.color.red, stroke.color.blue);
    }
  }
}

TEST(CurveTable, HasTheLastValuesOfRunsAndThoseOfReferencesAtThatStep) {
  EXPECT_EQ(
      CurveTable({Curve("seed1", {1000, 2500}), Curve("seed2", {1000, 2000})}, {Curve("table.csv", {2000, 9000})}),
      "run        episodes      steps  reward, last 100  score\n"
      "seed1            25       2500              2.50   5.00\n"
      "seed2            20       2000              2.00   4.00\n"
      "table.csv        20       2000              2.00   4.00\n");
}

}  // namespace
}  // namespace craftfleet
