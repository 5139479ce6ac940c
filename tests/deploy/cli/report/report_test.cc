#include "deploy/cli/report/report.h"

#include <cmath>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "deploy/cli/report/csv.h"
#include "tests/deploy/cli/report/sample_runs.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

// Rows: a table of two agents, a matrix of settings and agents, pairs. All of 4,000 steps, as WriteSampleRun's.
constexpr char kExperiments[] = R"(
  axes {
    name: "agent"
    choices { name: "ppo_cnn" label: "PPO-CNN" config { agent: "ppo_cnn" } }
    choices { name: "lstm_cnn" label: "LSTM-CNN" config { agent: "lstm_cnn" } }
  }
  axes {
    name: "numbers"
    choices { name: "easy" label: "easy" config { env { name: "crafter:numbers=easy-x2" } eval { env: "crafter" } } }
    choices { name: "hard" label: "hard" config { env { name: "crafter:numbers=hard-x2" } eval { env: "crafter" } } }
  }
  axes { name: "gamma" choices { name: "gamma=0.5" label: "0.5" config { ppo { gamma: 0.5 } } } }
  axes { name: "clip" choices { name: "clip=0.1" label: "0.1" config { ppo { clip: 0.1 } } } }
  experiments {
    name: "table" title: "The table" axes { axis: "agent" } milestones: []
    base { steps: 4000 lanes: 10 ppo { rollout_steps: 1000 minibatch_size: 100 } }
  }
  experiments {
    name: "matrix" title: "The matrix" axes { axis: "numbers" } axes { axis: "agent" }
    base { steps: 4000 lanes: 10 ppo { rollout_steps: 1000 minibatch_size: 100 } }
  }
  experiments {
    name: "pairs" title: "The pairs" axes { axis: "gamma" } axes { axis: "clip" } combine: PAIRS
    base { steps: 4000 lanes: 10 ppo { rollout_steps: 1000 minibatch_size: 100 } }
  }
)";
constexpr char kFigures[] =
    "table,cell,measure,at,mean,std,source\n"
    "table,ppo_cnn,train,,10.3,0.6,S\n"
    "matrix,easy/lstm_cnn,eval,,11.5,0.7,S\n"
    "matrix,average/ppo_cnn,train,,12.0,1.4,S\n"
    "matrix,average/ppo_cnn,eval,,9.1,0.9,S\n"
    "scale,human,train,,50.5,,Hafner 2021\n";

class ReportTest : public testing::Test {
 protected:
  Report Make() {
    experiments_ = ParseExperiments(kExperiments, "e").value();
    const auto runs = FindRuns({folder_.path()});
    EXPECT_THAT(runs, IsOk());
    return MakeReport(experiments_, PaperFigures::Parse(kFigures, "f").value(), runs->runs);
  }
  // The first line of `text` that begins so.
  static std::string Line(const std::string& text, const std::string& begin) {
    for (const absl::string_view line : absl::StrSplit(text, '\n')) {
      if (absl::StartsWith(line, begin)) return std::string(line);
    }
    return "";
  }

  const TempFolder folder_;
  std::vector<Experiment> experiments_;
};

// Scores: 101^(11/22) - 1 = 9.0499 and 101^(22/22) - 1 = 100; mean 54.5249, deviation (100 - 9.0499) / sqrt 2
// = 64.3115.
TEST_F(ReportTest, TablesHaveMeanAndDeviationOverSeedsBesideThePapers) {
  WriteSampleRun(folder_ / "a/seed1", 1, "", 40, 11);
  WriteSampleRun(folder_ / "a/seed2", 2, "", 40, 22);
  Report report = Make();
  EXPECT_EQ(report.complete, 2);
  EXPECT_THAT(Line(report.files["report.md"], "| PPO-CNN "),
              HasSubstr("| PPO-CNN | 10.3 ± 0.6 | 54.5 ± 64.3 | 2 | - | - | 16.5 ± 7.8 | 16.5 ± 7.8 | 16.5 ± 7.8 |"));
  const std::vector<std::string> cells = absl::StrSplit(Line(report.files["table.csv"], "table,ppo_cnn,train,"), ',');
  ASSERT_EQ(cells.size(), 9U);
  EXPECT_EQ(cells[4], "2");
  EXPECT_NEAR(std::stod(cells[5]), (std::sqrt(101) - 1 + 100) / 2, 1e-12);
  EXPECT_NEAR(std::stod(cells[6]), (100 - (std::sqrt(101) - 1)) / std::sqrt(2), 1e-12);
  EXPECT_EQ(cells[7], "10.3");
  EXPECT_EQ(cells[8], "0.6");
}

TEST_F(ReportTest, StepsAreThoseOfWholeIterations) {
  WriteSampleRun(folder_ / "a", 1, "steps: 3500", 40, 11);
  WriteSampleRun(folder_ / "b", 1, "steps: 3500", 20, 11);
  Report report = Make();
  EXPECT_THAT(Line(report.files["report.md"], absl::StrCat("| ", folder_ / "a")),
              HasSubstr("| 4,000 of 4,000 | yes |"));
  EXPECT_THAT(Line(report.files["report.md"], absl::StrCat("| ", folder_ / "b")), HasSubstr("| 2,000 of 4,000 | no |"));
}

TEST_F(ReportTest, ACellWithNoRunSaysSo) {
  Report report = Make();
  const std::string& text = report.files["report.md"];
  EXPECT_THAT(Line(text, "| PPO-CNN "), HasSubstr("| PPO-CNN | 10.3 ± 0.6 | no run |  |"));
  EXPECT_THAT(Line(text, "| easy | training score "), HasSubstr("| no run | no run |"));
  EXPECT_THAT(text, HasSubstr("| 0.5 | no run |"));
  EXPECT_EQ(Line(report.files["table.csv"], "table,lstm_cnn,train,"), "table,lstm_cnn,train,,0,,,,");
  EXPECT_THAT(text, HasSubstr("0 of 7 cells have a complete run"));
  for (const auto& [name, content] : report.files) EXPECT_THAT(name, Not(HasSubstr(".png")));
}

TEST_F(ReportTest, RunsWithOtherTexturesAreOtherCells) {
  WriteSampleRun(folder_ / "a/seed1", 1, "", 40, 11);
  WriteSampleRun(folder_ / "original/seed2", 2, "", 40, 22);
  WriteTextFile(folder_ / "original/seed2/run.json", R"({"texture_digest": "8140aa54698876d7"})");
  Report report = Make();
  const std::string& text = report.files["report.md"];
  EXPECT_THAT(Line(text, "| PPO-CNN "), HasSubstr("| 10.3 ± 0.6 | 9.0 | 1 |"));
  EXPECT_THAT(text, HasSubstr("(ppo_cnn, textures=8140aa54698876d7)"));
}

TEST_F(ReportTest, OneSeedHasNoDeviation) {
  WriteSampleRun(folder_ / "a/seed1", 1, "", 40, 11);
  Report report = Make();
  EXPECT_THAT(Line(report.files["report.md"], "| PPO-CNN "), HasSubstr("| 10.3 ± 0.6 | 9.0 | 1 |"));
  EXPECT_THAT(Line(report.files["table.csv"], "table,ppo_cnn,unlocked,"), HasSubstr("table,ppo_cnn,unlocked,,1,11,,,"));
}

TEST_F(ReportTest, UnfinishedRunsAreNamedAndNotAveraged) {
  WriteSampleRun(folder_ / "a/seed1", 1, "", 40, 11);
  WriteSampleRun(folder_ / "a/seed2", 2, "", 15, 22);
  WriteSampleRun(folder_ / "b/seed1", 1, "agent: 'lstm_cnn'", 25, 11);
  Report report = Make();
  const std::string& text = report.files["report.md"];
  EXPECT_EQ(report.complete, 1);
  EXPECT_THAT(Line(text, "| PPO-CNN "), HasSubstr("| 9.0 | 1 |"));
  EXPECT_THAT(text, HasSubstr("- PPO-CNN: not averaged because unfinished: seed 2 at 2,000 of 4,000 steps"));
  EXPECT_THAT(Line(text, "| LSTM-CNN "), HasSubstr("unfinished: seed 1 at 3,000 of 4,000 steps"));
  EXPECT_THAT(Line(report.files["table.csv"], "table,lstm_cnn,train,"), HasSubstr(",0,,,"));
}

TEST_F(ReportTest, ASeedThatIsThereTwiceCountsOnce) {
  WriteSampleRun(folder_ / "a/seed1", 1, "", 40, 11);
  WriteSampleRun(folder_ / "b/seed1", 1, "", 40, 11);
  const std::string text = Make().files["report.md"];
  EXPECT_THAT(Line(text, "| PPO-CNN "), HasSubstr("| 9.0 | 1 |"));
  EXPECT_THAT(text, HasSubstr("/b/seed1 not counted, seed 1 is there already"));
}

TEST_F(ReportTest, AMatrixHasTrainingAndEvaluationRowsAndAverages) {
  for (const char* numbers : {"easy-x2", "hard-x2"}) {
    const std::string run = folder_ / (std::string(numbers) + "/seed1");
    WriteSampleRun(run, 1, absl::StrCat("env { name: 'crafter:numbers=", numbers, "' } eval { env: 'crafter' }"), 40,
                   11);
    WriteTextFile(run + "/eval_sampled.jsonl", SameEpisodes(10, 22));
  }
  Report report = Make();
  const std::string& text = report.files["report.md"];
  EXPECT_EQ(Line(text, "| easy | training score "), "| easy | training score | 9.0 (n=1) | no run |");
  EXPECT_THAT(text, HasSubstr("|  | evaluation score | 100.0 (n=1) | no run<br>*paper 11.5 ± 0.7* |"));
  EXPECT_EQ(Line(text, "| average | training score "),
            "| average | training score | 9.0<br>*paper 12.0 ± 1.4* | 0 of 2 rows have runs |");
  EXPECT_EQ(report.files.count("matrix-heatmap.png"), 1U);
  EXPECT_EQ(report.files.count("matrix-curves-1.png"), 1U);
}

TEST_F(ReportTest, RunsOfNoCellHaveATableOfTheirOwn) {
  WriteSampleRun(folder_ / "mine/seed1", 1, "ppo { gamma: 0.123 }", 40, 11);
  const std::string text = Make().files["report.md"];
  EXPECT_THAT(text, HasSubstr("## Your own configurations"));
  EXPECT_THAT(Line(text, "| mine (ppo_cnn) "), HasSubstr("| 9.0 | 1 |"));
}

TEST_F(ReportTest, OwnRunsComeFirstEachUnderItsFolder) {
  WriteSampleRun(folder_ / "runs/wide", 1, "lanes: 20", 40, 11);
  WriteSampleRun(folder_ / "runs/low", 1, "ppo { gamma: 0.7 }", 40, 11);
  WriteSampleRun(folder_ / "paper/seed1", 1, "", 40, 11);
  Report report = Make();
  const std::string& text = report.files["report.md"];
  EXPECT_THAT(Line(text, "| wide (ppo_cnn, lanes=20) "), HasSubstr("| 9.0 | 1 |"));
  EXPECT_THAT(Line(text, "| low (ppo_cnn, lanes=10, gamma=0.7) "), HasSubstr("| 9.0 | 1 |"));
  EXPECT_LT(text.find("## Your own configurations"), text.find("## The table"));
  EXPECT_THAT(report.files["other.csv"], HasSubstr(absl::StrCat("other,", folder_ / "runs/wide", ",train,,1,")));
}

// The part of `text` that a page keeps closed until it is asked for.
std::string FoldedIn(const std::string& text) {
  std::string folded;
  for (size_t at = text.find("<details>"); at != std::string::npos; at = text.find("<details>", at + 1)) {
    folded += text.substr(at, text.find("</details>", at) - at);
  }
  return folded;
}

TEST_F(ReportTest, RowsWithoutARunAreFolded) {
  WriteSampleRun(folder_ / "a/seed1", 1, "", 40, 11);
  const std::string text = Make().files["report.md"];
  const std::string folded = FoldedIn(text);
  EXPECT_THAT(folded, Not(HasSubstr("\n| PPO-CNN |")));
  EXPECT_THAT(text, HasSubstr("<details><summary>1 cell without a run: LSTM-CNN</summary>\n\n| agent |"));
  EXPECT_THAT(folded, HasSubstr("\n| LSTM-CNN |"));
  // What has no run at all comes after everything that has.
  EXPECT_THAT(folded, HasSubstr("| easy | training score |"));
  EXPECT_LT(text.find("## Runs"), text.find("The matrix"));
  // Nothing else says "no run", but for the line that explains it.
  std::string shown = text;
  for (size_t at = shown.find("<details>"); at != std::string::npos; at = shown.find("<details>")) {
    shown.erase(at, shown.find("</details>", at) - at);
  }
  EXPECT_THAT(shown, Not(HasSubstr("| no run |")));
}

TEST_F(ReportTest, AHeatmapWithoutRunsIsNotDrawn) {
  WriteSampleRun(folder_ / "a/seed1", 1, "env { name: 'crafter:numbers=easy-x2' } eval { env: 'crafter' }", 0, 0);
  Report report = Make();
  EXPECT_EQ(report.files.count("matrix-heatmap.png"), 0U);
  EXPECT_EQ(report.files.count("matrix-curves.png"), 0U) << "a chart without a line";
}

TEST_F(ReportTest, TheListOfRunsNamesAFewCells) {
  WriteSampleRun(folder_ / "a/seed1", 1, "", 40, 11);
  Report report = Make();
  EXPECT_THAT(Line(report.files["report.md"], absl::StrCat("| ", folder_ / "a/seed1")), HasSubstr("| table/ppo_cnn |"));
}

TEST_F(ReportTest, ShowsEveryPictureThatItHasAndNoOther) {
  WriteSampleRun(folder_ / "a/seed1", 1, "", 40, 11);
  WriteSampleRun(folder_ / "b/seed1", 1, "ppo { gamma: 0.5 clip: 0.1 }", 40, 11);
  Report report = Make();
  int pictures = 0;
  for (const auto& [name, content] : report.files) {
    if (!absl::EndsWith(name, ".png")) continue;
    EXPECT_THAT(report.files["report.md"], HasSubstr("](" + name + ")"));
    EXPECT_TRUE(absl::StartsWith(content, "\x89PNG"));
    ++pictures;
  }
  EXPECT_EQ(pictures, 4);  // scores, curves and achievements of the table, heatmap of the pairs
  const std::vector<std::string> parts = absl::StrSplit(report.files["report.md"], "](");
  EXPECT_EQ(parts.size(), 5U);
}

TEST_F(ReportTest, AchievementsHaveTheirSuccessRates) {
  WriteSampleRun(folder_ / "a/seed1", 1, "", 40, 1);
  WriteSampleRun(folder_ / "a/seed2", 2, "", 40, 2);
  Report report = Make();
  EXPECT_EQ(Line(report.files["report.md"], "| collect_coal "), "| collect_coal | 100.0 ± 0.0 |");
  EXPECT_EQ(Line(report.files["report.md"], "| collect_diamond "), "| collect_diamond | 50.0 ± 70.7 |");
  EXPECT_THAT(report.files["achievements.csv"], HasSubstr("table,ppo_cnn,collect_drink,2,0,0\n"));
}

TEST_F(ReportTest, RunsAreListedWithTheirCells) {
  WriteSampleRun(folder_ / "a/seed7", 7, "", 40, 11);
  Report report = Make();
  EXPECT_THAT(report.files["runs.csv"],
              HasSubstr(absl::StrCat(folder_ / "a/seed7", ",table/ppo_cnn,ppo_cnn,crafter,,7,4000,4000,yes,")));
}

}  // namespace
}  // namespace craftfleet
