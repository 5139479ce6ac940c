#include "deploy/cli/sweep/slurm_array.h"

#include <cstdlib>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

// Runs task `task` of `script` with stand-ins for Slurm's commands: srun prints its arguments and exits with
// `srun_exit`, squeue prints `state`, scontrol prints its arguments. Returns what was printed and the exit code.
std::string RunTask(const std::string& script, int task, int srun_exit = 0, const std::string& state = "RUNNING") {
  const TempFolder folder;
  const std::string programs = "srun() { printf '[%s]' \"$@\"; return " + std::to_string(srun_exit) +
                               "; }\nsqueue() { echo " + state +
                               "; }\nscontrol() { echo scontrol \"$@\"; }\nexec() { \"$@\"; exit; }\n";
  EXPECT_THAT(WriteFileSynced(folder / "script", programs + script), IsOk());
  const std::string command = "SLURM_ARRAY_JOB_ID=7 SLURM_CPUS_PER_TASK=2 SLURM_ARRAY_TASK_ID=" + std::to_string(task) +
                              " bash " + (folder / "script") + " > " + (folder / "out") + "; echo \" exit $?\" >> " +
                              (folder / "out");
  EXPECT_EQ(std::system(command.c_str()), 0);
  return ReadFile(folder / "out").value();
}

SlurmArray TwoRuns() {
  SlurmArray array;
  array.logs = "/runs/slurm";
  array.at_a_time = 5;
  array.threads = 2;
  array.command = {"/bin/craftfleet-sweep", "/it's here/paper.txt", "--logdir=/runs"};
  array.runs = {"t/a/seed1", "t/b c/seed1"};
  return array;
}

TEST(SlurmArray, AsksForOneTaskForEachRun) {
  const std::string script = SlurmArrayScript(TwoRuns());
  EXPECT_THAT(script, StartsWith("#!/usr/bin/env bash\n"));
  for (const char* line : {"#SBATCH --array=0-1%5\n", "#SBATCH --output=\"/runs/slurm/%A_%a.log\"\n",
                           "#SBATCH --requeue\n", "#SBATCH --cpus-per-task=2\n", "#SBATCH --signal=TERM@60\n"}) {
    EXPECT_THAT(script, HasSubstr(line));
  }
}

TEST(SlurmArray, TheFolderOfTheLogsMayHaveAnyName) {
  SlurmArray array = TwoRuns();
  array.logs = "/my runs/100%A, größe \"1\"/slurm";
  EXPECT_THAT(SlurmArrayScript(array),
              HasSubstr("#SBATCH --output=\"/my runs/100%%A, größe \\\"1\\\"/slurm/%A_%a.log\"\n"));
}

TEST(SlurmArray, EachTaskRunsItsOwnRun) {
  const std::string script = SlurmArrayScript(TwoRuns());
  EXPECT_EQ(RunTask(script, 0),
            "[--cpu-bind=none][/bin/craftfleet-sweep][/it's "
            "here/paper.txt][--logdir=/runs][--run=t/a/seed1][--threads=2] exit 0\n");
  EXPECT_THAT(RunTask(script, 1), HasSubstr("[--run=t/b c/seed1]"));
}

TEST(SlurmArray, ATaskThatSlurmStopsIsRequeued) {
  const std::string script = SlurmArrayScript(TwoRuns());
  EXPECT_THAT(RunTask(script, 1, kSweepStopped), HasSubstr("scontrol requeue 7_1\n"));
}

TEST(SlurmArray, ATaskThatFailedOrIsCancelledIsNotRequeued) {
  const std::string script = SlurmArrayScript(TwoRuns());
  EXPECT_THAT(RunTask(script, 1, 1), HasSubstr("--threads=2] exit 1\n"));
  EXPECT_THAT(RunTask(script, 1, kSweepStopped, "COMPLETING"), HasSubstr("--threads=2] exit 75\n"));
}

TEST(ShellWord, IsReadBackAsOneWord) {
  EXPECT_EQ(ShellWord("--logdir=/runs/a,b"), "--logdir=/runs/a,b");
  EXPECT_EQ(ShellWord(""), "''");
  EXPECT_EQ(ShellWord("$x `y`"), "'$x `y`'");
  EXPECT_EQ(ShellWord("it's"), "'it'\\''s'");
}

}  // namespace
}  // namespace craftfleet
