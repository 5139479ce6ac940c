#include "deploy/cli/report/paper_figures.h"

#include <set>

#include <absl/strings/match.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "deploy/cli/report/run_group.h"
#include "deploy/cli/sweep/experiments.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/test_paths.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

const std::string kFile = SourcePath("deploy/experiments/paper_figures.csv");
const std::string kExperiments = SourcePath("deploy/experiments/paper.txt");
constexpr char kHeader[] = "table,cell,measure,at,mean,std,source\n";

TEST(PaperFigures, AreFoundByTableCellMeasureAndSteps) {
  const auto figures =
      PaperFigures::Parse(std::string("# a remark\n") + kHeader + "t,a/b,train,,1.5,0.2,S\nt,c,train,1000,2,,S\n", "f");
  ASSERT_THAT(figures, IsOk());
  const PaperFigure* first = figures->Find("t", "a/b", "train");
  ASSERT_NE(first, nullptr);
  EXPECT_EQ(first->mean, 1.5);
  EXPECT_EQ(first->deviation, 0.2);
  EXPECT_EQ(first->source, "S");
  EXPECT_EQ(figures->Find("t", "c", "train"), nullptr);
  ASSERT_NE(figures->Find("t", "c", "train", 1000), nullptr);
  EXPECT_FALSE(figures->Find("t", "c", "train", 1000)->deviation.has_value());
  EXPECT_EQ(figures->Find("t", "a/b", "eval"), nullptr);
}

TEST(PaperFigures, BadLinesAreNamed) {
  const auto message = [](const std::string& text) {
    return std::string(PaperFigures::Parse(text, "f.csv").status().message());
  };
  EXPECT_THAT(message("table,cell\n"), HasSubstr("f.csv:1: want the columns' names"));
  EXPECT_THAT(message(""), HasSubstr("f.csv: empty"));
  EXPECT_THAT(message(std::string(kHeader) + "t,a,train,,x,,S\n"), HasSubstr("f.csv:2: mean is \"x\", want a number"));
  EXPECT_THAT(message(std::string(kHeader) + "\nt,a,train,,1,y,S\n"), HasSubstr("f.csv:3: std is \"y\""));
  EXPECT_THAT(message(std::string(kHeader) + "t,a,train,z,1,,S\n"), HasSubstr("f.csv:2: at is \"z\""));
  EXPECT_THAT(message(std::string(kHeader) + "t,a,train,1,S\n"), HasSubstr("f.csv:2: 5 columns, want 7"));
  EXPECT_THAT(message(std::string(kHeader) + "t,a,train,,1,,S\nt,a,train,,2,,S\n"),
              HasSubstr("f.csv:3: t a train occurs twice"));
}

TEST(PaperFigures, EachOfThePaperHasItsCell) {
  const auto experiments = LoadExperiments(kExperiments);
  ASSERT_THAT(experiments, IsOk());
  std::set<std::string> cells;
  for (const Experiment& experiment : *experiments) {
    for (const Cell& cell : experiment.cells) cells.insert(experiment.name + "/" + cell.name);
  }
  const auto figures = PaperFigures::Parse(ReadFile(kFile).value(), kFile);
  ASSERT_THAT(figures, IsOk());
  int count = 0;
  for (const PaperFigure& figure : figures->all()) {
    EXPECT_EQ(MeasureNamed(figure.measure).name, figure.measure);
    if (figure.table == "scale" || absl::StartsWith(figure.cell, "average/")) continue;
    EXPECT_EQ(cells.count(figure.table + "/" + figure.cell), 1U) << figure.table << " " << figure.cell;
    ++count;
  }
  // Table 1 with its unlocked achievements, no inventory, asymptotic, two of OOD, ablation, beyond.
  EXPECT_EQ(count, 12 + 1 + 2 + 12 + 96 + 96 + 21 + 4);
}

// Stanic et al. 2022, Table 1 and the OOD tables: a number from each corner.
TEST(PaperFigures, AreThoseOfThePaper) {
  const auto figures = PaperFigures::Parse(ReadFile(kFile).value(), kFile);
  ASSERT_THAT(figures, IsOk());
  const auto check = [&](const char* table, const char* cell, const char* measure, double mean, double deviation) {
    const PaperFigure* figure = figures->Find(table, cell, measure);
    ASSERT_NE(figure, nullptr) << cell;
    EXPECT_EQ(figure->mean, mean) << cell;
    EXPECT_EQ(figure->deviation.value_or(0), deviation) << cell;
  };
  check("table1", "ppo_cnn", "train", 10.4, 0.6);
  check("table1", "ppo_cnn", "eval", 10.3, 0.6);
  check("table1", "lstm_spcnn", "train", 12.3, 0.4);
  check("table1", "lstm_spcnn", "eval", 12.1, 0.8);
  check("no_inventory", "lstm_cnn", "train", 7.7, 0.5);
  check("ood_app", "ordinary/ppo_cnn", "train", 10.4, 0.6);
  check("ood_app", "100-0-0-0/oc_ca", "eval", 7.6, 0.5);
  check("ood_num", "easy-x2_default/ppo_cnn", "train", 12.4, 2);
  check("ood_num", "easy-x4_hard-x4/oc_ca", "eval", 4.2, 0.3);
  check("ood_num", "average/oc_sa", "train", 14.5, 1.3);
  check("ablation", "patch=16-8", "train", 6.2, 0.5);
  check("beyond", "achievement_distillation", "train", 21.79, 1.37);
  check("scale", "human", "train", 50.5, 0);
  EXPECT_EQ(figures->Find("asymptotic", "ppo_spcnn", "train", 20'000'000)->mean, 30.5);
}

// The paper's Table 1 is the evaluation row of O1 100%; the training row of that table has the figures of training
// episodes.
TEST(PaperFigures, TableOneIsTheRowOfTheOriginalAppearance) {
  const auto figures = PaperFigures::Parse(ReadFile(kFile).value(), kFile);
  ASSERT_THAT(figures, IsOk());
  for (const char* agent : {"ppo_cnn", "ppo_spcnn", "lstm_cnn", "lstm_spcnn", "oc_sa", "oc_ca"}) {
    for (const char* measure : {"train", "eval"}) {
      const PaperFigure* table1 = figures->Find("table1", agent, measure);
      const PaperFigure* row = figures->Find("ood_app", std::string("ordinary/") + agent, measure);
      ASSERT_TRUE(table1 != nullptr && row != nullptr) << agent << " " << measure;
      EXPECT_EQ(table1->mean, row->mean) << agent << " " << measure;
      EXPECT_EQ(table1->deviation, row->deviation) << agent << " " << measure;
    }
  }
}

}  // namespace
}  // namespace craftfleet
