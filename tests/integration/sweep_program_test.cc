// `craftfleet sweep` and `craftfleet report` as programs, over real training.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/test_paths.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

// Two cells of 192 steps.
class SweepProgramTest : public SmallRunTest {
 protected:
  SweepProgramTest() {
    EXPECT_THAT(WriteFileSynced(experiments(), R"(
      [[axes]]
      name = "gamma"
      choices = [
        { name = "gamma=0.9", config = { ppo.gamma = 0.9 } },
        { name = "gamma=0.5", config = { ppo.gamma = 0.5 } },
      ]
      [[experiments]]
      name = "small"
      axes = [{ axis = "gamma" }]
      [experiments.base]
      steps = 192
      lanes = 4
      fragment_steps = 16
      env = { length = 20 }
      ppo = { rollout_steps = 64, minibatch_size = 32, epochs = 1 }
      eval = { every_steps = 64, episodes = 1, final_episodes = 2 }
      checkpoint = { every_iterations = 1 }
    )"),
                IsOk());
  }

  std::string experiments() const { return folder_ / "experiments.toml"; }
  std::string RunFolder(const std::string& run) const { return folder_ / ("runs/small/" + run); }
  std::vector<std::string> SweepArguments(const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {experiments(), "--seeds=2", "--jobs=2", "--logdir=" + (folder_ / "runs")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  }
  Ended Sweep(const std::vector<std::string>& more = {}) { return Run("craftfleet sweep", SweepArguments(more)); }
};

TEST_F(SweepProgramTest, RunsResumesReportsAndNeverRunsAFinishedCellAgain) {
  // Killed at a random point: its children continue or are resumed.
  const std::unique_ptr<Process> killed = Start("craftfleet sweep", SweepArguments());
  ASSERT_TRUE(killed->WaitForText("starts: ", kPatience));
  killed->Kill();

  const Ended first = Sweep();
  ASSERT_EQ(first.exit_code, 0) << first.out << first.err;
  EXPECT_THAT(first.out, HasSubstr("4 done, 0 running, 0 left, 0 failed | 768/768 steps"));
  for (const char* run : {"gamma=0.9/seed1", "gamma=0.9/seed2", "gamma=0.5/seed1", "gamma=0.5/seed2"}) {
    EXPECT_TRUE(PathExists(RunFolder(run) + "/final_sampled.jsonl")) << run;
    EXPECT_TRUE(PathExists(RunFolder(run) + "/log.txt")) << run;
  }

  const std::string log = ReadFile(RunFolder("gamma=0.5/seed2") + "/log.txt").value();
  const Ended second = Sweep();
  EXPECT_EQ(second.exit_code, 0);
  EXPECT_THAT(second.out, HasSubstr("4 runs, of which 4 are done already"));
  EXPECT_THAT(second.out, Not(HasSubstr("begins")));
  EXPECT_EQ(ReadFile(RunFolder("gamma=0.5/seed2") + "/log.txt").value(), log);

  const Ended report =
      Run("craftfleet report", {folder_ / "runs", "--experiments=" + experiments(), "--out=" + (folder_ / "report")});
  ASSERT_EQ(report.exit_code, 0) << report.err;
  EXPECT_THAT(report.out, HasSubstr("4 runs, 4 complete"));
  EXPECT_THAT(ReadFile(folder_ / "report/report.md").value(),
              HasSubstr("2 of 2 configurations have a complete run (2 cells"));
  const Ended page = Run("craftfleet report", {folder_ / "runs", "--experiments=" + experiments(), "--out=-"});
  ASSERT_EQ(page.exit_code, 0) << page.err;
  EXPECT_EQ(page.out, ReadFile(folder_ / "report/report.md").value());
  EXPECT_THAT(page.err, HasSubstr("4 runs, 4 complete; report.md written to standard output"));

  const std::string damaged = RunFolder("gamma=0.9/seed1") + "/config.txt";
  ASSERT_THAT(WriteFileSynced(damaged, "no configuration"), IsOk());
  const Ended rest = Run("craftfleet report", {folder_ / "runs", "--out=-"});
  EXPECT_EQ(rest.exit_code, 0) << rest.err;
  EXPECT_THAT(rest.err, AllOf(HasSubstr("warning: left out: " + damaged), HasSubstr("3 runs, 3 complete; 1 more")));
  const Ended none = Run("craftfleet report", {RunFolder("gamma=0.9/seed1"), "--out=-"});
  EXPECT_EQ(none.exit_code, 1);
  EXPECT_THAT(none.err, HasSubstr(damaged));
}

TEST_F(SweepProgramTest, BadArgumentsAreNamed) {
  EXPECT_THAT(Run("craftfleet sweep", {}).err, HasSubstr("name one file with experiments"));
  EXPECT_THAT(Run("craftfleet sweep", {"/nowhere.toml"}).err, HasSubstr("/nowhere.toml"));
  EXPECT_THAT(Run("craftfleet sweep", {experiments()}).err, HasSubstr("--logdir is missing"));
  EXPECT_THAT(Sweep({"--jobs=0"}).err, HasSubstr("--jobs=0, want 1..1000"));
  EXPECT_THAT(Sweep({"--experiment=x"}).err, HasSubstr("--experiment=x, want one of small"));
  EXPECT_THAT(Run("craftfleet report", {"--out=r"}).err, HasSubstr("name at least one folder with runs"));
  EXPECT_THAT(Run("craftfleet report", {"/nowhere", "--out=r"}).err, HasSubstr("/nowhere: no such folder"));
  EXPECT_THAT(Run("craftfleet report", {folder_.path()}).err, HasSubstr("--out is missing"));
  EXPECT_THAT(Run("craftfleet report", {"/nowhere", "--out=" + experiments()}).err,
              AllOf(HasSubstr("is not a folder; want a folder"), Not(HasSubstr("no such folder"))));
}

TEST_F(SweepProgramTest, ADryRunOnlyPrintsTheCommands) {
  const std::string textures = SourcePath("envserver/textures");
  const Ended ended = Sweep({"--dry_run", "--cell=gamma=0.5", "--threads=1", "--textures=" + textures});
  EXPECT_EQ(ended.exit_code, 0) << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("craftfleet train --config=" + (folder_ / "runs/small/gamma=0.5/cell.txt") +
                                   " --seed=2 --steps=192 --logdir=" + RunFolder("gamma=0.5/seed2") +
                                   " --threads=1 --textures=" + textures + "\n"));
  EXPECT_THAT(ended.out, Not(HasSubstr("gamma=0.9")));
  EXPECT_FALSE(PathExists(folder_ / "runs"));
}

}  // namespace
}  // namespace craftfleet
