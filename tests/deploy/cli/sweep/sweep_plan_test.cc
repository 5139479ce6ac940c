#include "deploy/cli/sweep/sweep_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/config.h"
#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

// Cells t/x/p, t/x/q, t/y/p, t/y/q and u/p, which is t/x/p.
std::vector<Experiment> SampleExperiments() {
  return ParseExperiments(R"(
    axes {
      name: "outer"
      choices { name: "x" }
      choices { name: "y" config { ppo { gamma: 0.5 } } }
    }
    axes {
      name: "inner"
      choices { name: "p" }
      choices { name: "q" config { ppo { clip: 0.5 } } }
    }
    experiments { name: "t" axes { axis: "outer" } axes { axis: "inner" } }
    experiments { name: "u" axes { axis: "inner" only: "p" } }
  )",
                          "file.txt")
      .value();
}

std::vector<std::string> Select(const CellFilter& filter) {
  static const auto* const experiments = new std::vector<Experiment>(SampleExperiments());
  std::vector<std::string> names;
  const auto selected = SelectCells(*experiments, filter);
  if (!selected.ok()) return {std::string(selected.status().message())};
  for (const Cell* cell : *selected) names.push_back(cell->experiment + "/" + cell->name);
  return names;
}

std::vector<std::string> JobNames(const std::vector<SweepJob>& jobs) {
  std::vector<std::string> names;
  for (const SweepJob& job : jobs) names.push_back(job.name);
  return names;
}

TEST(SelectCells, TakesAllOrThoseNamed) {
  EXPECT_THAT(Select({}), ElementsAre("t/x/p", "t/x/q", "t/y/p", "t/y/q", "u/p"));
  EXPECT_THAT(Select({{"u"}, {}}), ElementsAre("u/p"));
  EXPECT_THAT(Select({{}, {"x/q", "y/p"}}), ElementsAre("t/x/q", "t/y/p"));
  EXPECT_THAT(Select({{"t"}, {"y"}}), ElementsAre("t/y/p", "t/y/q"));
}

TEST(SelectCells, RefusesUnknownNames) {
  EXPECT_THAT(Select({{"v"}, {}}), ElementsAre("--experiment=v, want one of t, u"));
  EXPECT_THAT(Select({{"u"}, {"x"}}), ElementsAre(HasSubstr("--cell=x, want")));
}

TEST(CellsWithTextures, LeavesOutThoseThatWantOthers) {
  Cell any;
  Cell original;
  original.experiment = "e";
  original.name = "c";
  original.texture_digest = "0123456789abcdef";
  EXPECT_EQ(CellsWithTextures({&any, &original}, "fedcba9876543210").value(), std::vector<const Cell*>{&any});
  EXPECT_EQ(CellsWithTextures({&any, &original}, "0123456789abcdef").value().size(), 2U);
  const absl::Status status = CellsWithTextures({&original}, "fedcba9876543210").status();
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(status.message(),
            "cell e/c wants textures 0123456789abcdef, not fedcba9876543210: give their folder with --textures");
}

TEST(PlanSweep, HasEveryCellWithEachSeedAndSharedOnesOnce) {
  const std::vector<Experiment> experiments = SampleExperiments();
  const auto cells = SelectCells(experiments, {{}, {"x", "p"}});
  ASSERT_THAT(cells, IsOk());
  SweepSettings settings;
  settings.logdir = "runs";
  settings.seeds = 2;
  const std::vector<SweepJob> jobs = PlanSweep(*cells, settings);
  EXPECT_THAT(JobNames(jobs), ElementsAre("t/x/p/seed1", "t/x/q/seed1", "t/x/p/seed2", "t/x/q/seed2"));
  EXPECT_EQ(jobs[1].folder, "runs/t/x/q/seed1");
}

TEST(PlanSweep, HasTheCommandsThatStartAndResumeARun) {
  const std::vector<Experiment> experiments = SampleExperiments();
  SweepSettings settings;
  settings.logdir = "runs";
  settings.seeds = 1;
  settings.train_flags = {"--threads=3"};
  const SweepJob job = PlanSweep({&experiments[0].cells[1]}, settings)[0];
  EXPECT_THAT(job.start, ElementsAre("--config=runs/t/x/q/cell.txt", "--seed=1", "--steps=1000000",
                                     "--logdir=runs/t/x/q/seed1", "--threads=3"));
  EXPECT_THAT(job.resume, ElementsAre("--resume", "--steps=1000000", "--logdir=runs/t/x/q/seed1", "--threads=3"));
  EXPECT_EQ(job.config.steps(), 1'000'000);
}

TEST(PlanSweep, StepsAreTheCellsUnlessGiven) {
  const std::vector<Experiment> experiments = SampleExperiments();
  SweepSettings settings;
  settings.steps = 5000;
  const SweepJob job = PlanSweep({&experiments[0].cells[0]}, settings)[0];
  EXPECT_EQ(job.config.steps(), 5000);
  EXPECT_THAT(job.start, testing::Contains("--steps=5000"));
}

TEST(WriteCellConfigs, EachFileGivesTheCellsConfiguration) {
  const TempFolder folder;
  const std::vector<Experiment> experiments = SampleExperiments();
  const auto cells = SelectCells(experiments, {});
  ASSERT_THAT(cells, IsOk());
  ASSERT_THAT(WriteCellConfigs(*cells, folder / "configs"), IsOk());
  for (const Cell* cell : *cells) {
    const std::string path = folder / ("configs/" + cell->experiment + "/" + cell->name + ".txt");
    const auto text = ReadFile(path);
    ASSERT_THAT(text, IsOk());
    const auto config = ParseRunConfig(*text, path);
    ASSERT_THAT(config, IsOk());
    EXPECT_EQ(FormatRunConfig(*ResolveRunConfig(*config)), FormatRunConfig(cell->config));
  }
}

}  // namespace
}  // namespace craftfleet
