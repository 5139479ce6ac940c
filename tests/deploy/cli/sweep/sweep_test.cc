#include "deploy/cli/sweep/sweep.h"

#include <cstdlib>
#include <fstream>
#include <sstream>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "learner/run/checkpoint_store.h"
#include "learner/run/folder_lock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/test_paths.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;
using testing::SizeIs;

// Two cells of 8,192 steps, run by fake_train.
class SweepTest : public testing::Test {
 protected:
  void SetUp() override { SetMode(""); }

  static void SetMode(const char* mode) { setenv("FAKE_TRAIN", mode, /*overwrite=*/1); }

  std::vector<SweepJob> Jobs(int seeds, double gamma = 0.5) {
    experiments_ = ParseExperiments(
                       "axes { name: \"gamma\" choices { name: \"a\" } choices { name: \"b\" config { ppo { "
                       "gamma: " +
                           std::to_string(gamma) +
                           " } } } } "
                           "experiments { name: \"t\" base { steps: 8192 } axes { axis: \"gamma\" } }",
                       "file.txt")
                       .value();
    SweepSettings settings;
    settings.logdir = folder_.path();
    settings.seeds = seeds;
    return PlanSweep(SelectCells(experiments_, {}).value(), settings);
  }

  std::unique_ptr<Sweep> Make(int seeds, double gamma = 0.5) {
    Sweep::Options options;
    options.program = BuiltProgram("fake_train");
    options.jobs = 2;
    options.look_again = absl::Milliseconds(20);
    return std::make_unique<Sweep>(Jobs(seeds, gamma), options, &out_, &clock_);
  }
  absl::Status Run(int seeds = 1) { return Make(seeds)->Run(); }

  // The arguments with which the run was started, one line for each time.
  std::vector<std::string> Starts(const std::string& run) const {
    std::ifstream file(folder_ / ("t/" + run + "/starts"));
    std::vector<std::string> lines;
    for (std::string line; std::getline(file, line);) lines.push_back(line);
    return lines;
  }

  const TempFolder folder_;
  std::vector<Experiment> experiments_;
  std::ostringstream out_;
  RealClock clock_;
};

TEST_F(SweepTest, RunsEveryCellWithEverySeed) {
  ASSERT_THAT(Run(3), IsOk());
  for (const char* run : {"a/seed1", "a/seed2", "a/seed3", "b/seed1", "b/seed2", "b/seed3"}) {
    ASSERT_THAT(Starts(run), SizeIs(1)) << run;
    EXPECT_THAT(Starts(run)[0], Not(HasSubstr("--resume")));
    EXPECT_TRUE(PathExists(folder_ / (std::string("t/") + run + "/log.txt")));
  }
  EXPECT_THAT(out_.str(), HasSubstr("6 done, 0 running, 0 left, 0 failed | 49,152/49,152 steps"));
}

TEST_F(SweepTest, NeverRunsAFinishedCellAgain) {
  ASSERT_THAT(Run(1), IsOk());
  ASSERT_THAT(Run(2), IsOk());
  EXPECT_THAT(Starts("a/seed1"), SizeIs(1));
  EXPECT_THAT(Starts("a/seed2"), SizeIs(1));
}

TEST_F(SweepTest, ResumesUnfinishedRuns) {
  SetMode("half");
  EXPECT_THAT(Run(), StatusIs(absl::StatusCode::kInternal, "2 of 2 runs failed"));
  EXPECT_THAT(out_.str(), HasSubstr("FAILED: t/a/seed1: it ended at 4096 of 8192 steps"));
  SetMode("");
  ASSERT_THAT(Run(), IsOk());
  ASSERT_THAT(Starts("b/seed1"), SizeIs(2));
  EXPECT_THAT(Starts("b/seed1")[1], HasSubstr("--resume --steps=8192"));
}

TEST_F(SweepTest, AFailedRunIsReportedWithItsLastLineAndStopsNoOther) {
  SetMode("fail2");
  EXPECT_THAT(Run(3), StatusIs(absl::StatusCode::kInternal, "2 of 6 runs failed"));
  EXPECT_THAT(out_.str(), HasSubstr("FAILED: t/a/seed2: exit code 3: the last line says why"));
  EXPECT_THAT(Starts("b/seed3"), SizeIs(1));
  EXPECT_THAT(out_.str(), HasSubstr("4 done, 0 running, 0 left, 2 failed"));
}

TEST_F(SweepTest, StopForwardsTheSignalAndWaits) {
  SetMode("wait");
  const std::unique_ptr<Sweep> sweep = Make(2);
  absl::Status status;
  std::thread run([&] { status = sweep->Run(); });
  const auto half_done = [&](const char* name) {
    return ReadRunState(folder_ / name, 8192).value_or(RunState()).begun;
  };
  EXPECT_TRUE(WaitUntil([&] { return half_done("t/a/seed1") && half_done("t/b/seed1"); }));
  sweep->Stop();
  run.join();
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kCancelled, HasSubstr("stopped with 0 of 4 runs done")));
  EXPECT_THAT(Starts("a/seed2"), SizeIs(0));
  // The folders are no longer locked.
  EXPECT_THAT(FolderLock::Acquire(folder_ / "t/a/seed1"), IsOk());
}

TEST_F(SweepTest, WaitsForAFolderThatAnotherProcessUses) {
  ASSERT_THAT(CreateFolders(folder_ / "t/a/seed1"), IsOk());
  auto held = std::make_unique<FolderLock>(FolderLock::Acquire(folder_ / "t/a/seed1").value());
  const std::unique_ptr<Sweep> sweep = Make(1);
  absl::Status status;
  std::thread run([&] { status = sweep->Run(); });
  EXPECT_TRUE(WaitUntil([&] { return ReadRunState(folder_ / "t/b/seed1", 8192).value_or(RunState()).finished; }));
  EXPECT_THAT(Starts("a/seed1"), SizeIs(0));
  held.reset();
  run.join();
  EXPECT_THAT(status, IsOk());
  EXPECT_THAT(Starts("a/seed1"), SizeIs(1));
}

TEST_F(SweepTest, RefusesAFolderWithAnotherConfiguration) {
  SetMode("half");
  ASSERT_FALSE(Run().ok());
  SetMode("");
  EXPECT_FALSE(Make(1, /*gamma=*/0.6)->Run().ok());
  EXPECT_THAT(out_.str(), HasSubstr("FAILED: t/b/seed1: "));
  EXPECT_THAT(out_.str(), HasSubstr("is not this cell's configuration"));
  EXPECT_THAT(Starts("b/seed1"), SizeIs(1));
}

TEST_F(SweepTest, AMissingProgramFailsEveryRun) {
  Sweep::Options options;
  options.program = "/nowhere/craftfleet-train";
  Sweep sweep(Jobs(1), options, &out_, &clock_);
  EXPECT_FALSE(sweep.Run().ok());
  EXPECT_THAT(out_.str(), HasSubstr("cannot start /nowhere/craftfleet-train: No such file or directory"));
}

TEST_F(SweepTest, ARunIsFinishedOnlyWithItsLastEvaluation) {
  ASSERT_THAT(Run(), IsOk());
  const std::string path = folder_ / "t/a/seed1";
  EXPECT_TRUE(ReadRunState(path, 8192)->finished);
  EXPECT_FALSE(ReadRunState(path, 8193)->finished);
  const std::string folder = FindCheckpoint(path).value();
  Checkpoint checkpoint = LoadCheckpoint(folder, "").value();
  checkpoint.state.mutable_config()->mutable_eval()->set_final_episodes(20);
  checkpoint.state.set_final_evaluation_steps(0);
  ASSERT_THAT(RemoveAll(folder), IsOk());
  ASSERT_THAT(WriteCheckpointFiles(folder, checkpoint), IsOk());
  EXPECT_FALSE(ReadRunState(path, 8192)->finished);
  EXPECT_EQ(ReadRunState(path, 8192)->steps, 8192);
}

}  // namespace
}  // namespace craftfleet
