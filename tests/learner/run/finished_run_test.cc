// A run that is extended after its end.

#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/learner/run/run_folder_fixture.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;

// A run that ended after 4096 steps, with a final evaluation of one episode of each kind.
class FinishedRunTest : public RunFolderTest {
 protected:
  FinishedRunTest() {
    const auto folder = Create();
    EXPECT_THAT(folder->WriteCheckpoint(State(1, 0)), IsOk());
    EndAt(folder.get(), 4096);
  }
  static Checkpoint State(int64_t iteration, int64_t final_evaluation_steps) {
    Checkpoint checkpoint = SampleCheckpoint(iteration);
    checkpoint.state.set_env_steps(iteration * 1024);
    checkpoint.state.set_final_evaluation_steps(final_evaluation_steps);
    return checkpoint;
  }
  static std::string Lines(int64_t steps) { return FormatStatsLine(SampleEpisode(steps, 1)); }
  // The final evaluation, whose episodes are as long as the run, and the last checkpoint.
  static void EndAt(RunFolder* folder, int64_t steps) {
    folder->AddEvaluation(true, {SampleEpisode(steps, 1)}, {SampleEpisode(steps, 1)});
    EXPECT_THAT(folder->WriteCheckpoint(State(steps / 1024, steps)), IsOk());
  }
  // Resumes with another number of steps.
  std::unique_ptr<RunFolder> ResumeTo(int64_t steps, const std::string& from = "") {
    absl::StatusOr<ResumedRun> run = Look(from);
    EXPECT_THAT(run, IsOk());
    if (!run.ok()) return nullptr;
    v1::RunConfig config = run->folder->config();
    config.set_steps(steps);
    run->folder->TakeChanges(config);
    EXPECT_THAT(run->folder->Begin(), IsOk());
    return std::move(run->folder);
  }
  std::string Text(const std::string& file) const { return ReadFile(JoinPath(logdir_, file)).value_or("none"); }
  void ExpectLogs(const std::string& final, const std::string& aside) {
    for (const char* kind : {"argmax", "sampled"}) {
      EXPECT_EQ(Text(absl::StrCat("final_", kind, ".jsonl")), final) << kind;
      EXPECT_EQ(Text(absl::StrCat("final_", kind, "-4096.jsonl")), aside) << kind;
    }
  }
};

TEST_F(FinishedRunTest, ResumedUnchangedItKeepsItsFinalLogs) {
  const auto run = ResumeTo(4096);
  ExpectLogs(Lines(4096), "none");
  EXPECT_EQ(run->score(EpisodeKind::kFinalArgmax).MeanLength(), 4096);
}

TEST_F(FinishedRunTest, ExtendedItsFinalLogsBelongToTheNewestWeights) {
  auto run = ResumeTo(8192);
  ExpectLogs("", Lines(4096));
  EXPECT_EQ(run->score(EpisodeKind::kFinalArgmax).episodes(), 0);
  EndAt(run.get(), 8192);
  ExpectLogs(Lines(8192), Lines(4096));
  EXPECT_EQ(run->score(EpisodeKind::kFinalSampled).MeanLength(), 8192);
  run.reset();
  run = ResumeTo(12'288);
  ExpectLogs("", Lines(4096));
  EXPECT_EQ(Text("final_argmax-8192.jsonl"), Lines(8192));
}

TEST_F(FinishedRunTest, KilledAfterAnExtensionItCanBeResumedEitherWay) {
  ResumeTo(8192);
  ResumeTo(8192);  // from the checkpoint of the old end, which finds the logs set aside
  ExpectLogs("", Lines(4096));
  const auto run = ResumeTo(4096);
  ExpectLogs(Lines(4096), "none");
  EXPECT_EQ(run->score(EpisodeKind::kFinalSampled).MeanLength(), 4096);
}

TEST_F(FinishedRunTest, StoppedDuringTheExtensionItsLogsStayAside) {
  auto run = ResumeTo(8192);
  ASSERT_THAT(run->WriteCheckpoint(State(6, 4096)), IsOk());
  run.reset();
  run = ResumeTo(8192);
  ExpectLogs("", Lines(4096));
  run.reset();
  EXPECT_THAT(Resume(), IsOk());
  ExpectLogs("", Lines(4096));
}

TEST_F(FinishedRunTest, ResumedFromItsOldEndItHasThatEndsLogs) {
  auto run = ResumeTo(8192);
  EndAt(run.get(), 8192);
  run.reset();
  run = ResumeTo(4096, "iter-00000004");
  ExpectLogs(Lines(4096), "none");
  EXPECT_EQ(run->score(EpisodeKind::kFinalArgmax).MeanLength(), 4096);
  EXPECT_THAT(run->checkpoints().ListNewestFirst().value(), ElementsAre("iter-00000004", "iter-00000001"));
}

TEST_F(FinishedRunTest, ResumedFromBeforeItsOldEndItHasNoFinalLogs) {
  auto run = ResumeTo(8192);
  EndAt(run.get(), 8192);
  run.reset();
  run = ResumeTo(8192, "iter-00000001");
  ExpectLogs("", "none");
}

// A learner was killed while it wrote the lines of a later end.
TEST_F(FinishedRunTest, OnlyTheLinesOfTheCheckpointAreSetAside) {
  ASSERT_THAT(WriteFileSynced(logdir_ + "/final_argmax.jsonl", Lines(4096) + Lines(5000)), IsOk());
  ResumeTo(8192);
  EXPECT_EQ(Text("final_argmax.jsonl"), "");
  EXPECT_EQ(Text("final_argmax-4096.jsonl"), Lines(4096));
}

}  // namespace
}  // namespace craftfleet
