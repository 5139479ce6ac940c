#include "learner/run/run_folder.h"

#include <unistd.h>

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/config/config.h"
#include "common/io/files.h"
#include "learner/run/epoch.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/file_size_limit.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

TEST(Epoch, CountsStarts) {
  const TempFolder folder;
  EXPECT_EQ(ReadEpoch(folder.path()).value(), 0);
  EpochFence first, second;
  ASSERT_THAT(first.Take(folder.path(), 1), IsOk());
  EXPECT_EQ(ReadEpoch(folder.path()).value(), 1);
  ASSERT_THAT(second.Take(folder.path(), 2), IsOk());
  EXPECT_EQ(ReadEpoch(folder.path()).value(), 2);
  for (const char* garbage : {"", "x", "-1", "0", "1 2"}) {
    ASSERT_THAT(WriteFileSynced(folder / "epoch", garbage), IsOk());
    EXPECT_THAT(ReadEpoch(folder.path()), StatusIs(absl::StatusCode::kDataLoss, HasSubstr(folder / "epoch")))
        << garbage;
    EXPECT_THAT(second.Check(), StatusIs(absl::StatusCode::kUnavailable, HasSubstr(folder / "epoch"))) << garbage;
  }
}

TEST(Epoch, ReadsTheFormatOfVersion01) {
  const TempFolder folder;
  ASSERT_THAT(WriteFileSynced(folder / "epoch", "7\n"), IsOk());
  EXPECT_EQ(ReadEpoch(folder.path()).value(), 7);
  EpochFence fence;
  EXPECT_THAT(fence.Take(folder.path(), 7), StatusIs(absl::StatusCode::kFailedPrecondition, testing::_));
  EXPECT_THAT(fence.Take(folder.path(), 8), IsOk());
}

TEST(EpochFence, OnlyTheLatestStartMayWrite) {
  const TempFolder folder;
  EpochFence older, newer;
  EXPECT_THAT(older.Check(), StatusIs(absl::StatusCode::kFailedPrecondition, testing::_));
  ASSERT_THAT(older.Take(folder.path(), 1), IsOk());
  EXPECT_THAT(older.Check(), IsOk());
  EXPECT_THAT(newer.Take(folder.path(), 1),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr(absl::StrCat("process ", ::getpid()))));
  ASSERT_THAT(newer.Take(folder.path(), 2), IsOk());
  EXPECT_THAT(newer.Check(), IsOk());
  EXPECT_THAT(older.Check(),
              StatusIs(absl::StatusCode::kAborted,
                       AllOf(HasSubstr(folder.path()), HasSubstr(absl::StrCat("taken over by process ", ::getpid())),
                             HasSubstr("epoch 2, this one is epoch 1"))));
}

// Two starts read the same number at the same time.
TEST(EpochFence, OfTwoStartsWithOneNumberOnlyTheLastMayWrite) {
  const TempFolder folder, elsewhere;
  EpochFence first, last;
  ASSERT_THAT(first.Take(folder.path(), 3), IsOk());
  ASSERT_THAT(last.Take(elsewhere.path(), 3), IsOk());
  ASSERT_THAT(WriteFileSynced(folder / "epoch", ReadFile(elsewhere / "epoch").value()), IsOk());
  EXPECT_THAT(first.Check(), StatusIs(absl::StatusCode::kAborted, testing::_));
}

class RunFolderTest : public testing::Test {
 protected:
  std::unique_ptr<RunFolder> Create() {
    auto folder = RunFolder::Create(logdir_, ResolveRunConfig(DefaultRunConfig()).value(), program_, &clock_);
    EXPECT_THAT(folder, IsOk());
    if (!folder.ok()) return nullptr;
    EXPECT_THAT((*folder)->Begin(), IsOk());
    return *std::move(folder);
  }
  absl::StatusOr<ResumedRun> Look(const ResumeOptions& options = {}) {
    return RunFolder::Resume(logdir_, options, program_, &clock_);
  }
  absl::StatusOr<ResumedRun> Resume(const ResumeOptions& options = {}) {
    absl::StatusOr<ResumedRun> run = Look(options);
    EXPECT_TRUE(!run.ok() || run->folder->Begin().ok());
    return run;
  }
  // The content of each file except `lock`, which names its last holder.
  std::map<std::string, std::string> Contents() const {
    std::map<std::string, std::string> contents;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(logdir_)) {
      const std::string path = entry.path().string();
      if (path != logdir_ + "/lock") contents[path] = entry.is_regular_file() ? ReadFile(path).value() : "folder";
    }
    return contents;
  }

  // A run of two iterations with a checkpoint after each, then some logs that are in no checkpoint.
  void MakeRun() {
    auto folder = Create();
    for (int64_t iteration = 1; iteration <= 3; ++iteration) {
      folder->AddEpisodes({SampleEpisode(100 * iteration, 1.0 * iteration), SampleEpisode(10, 0)});
      folder->AddScalars(4096 * iteration, {{"train/reward", 1.0 * iteration}});
      ASSERT_THAT(folder->FlushLogs(), IsOk());
      if (iteration == 3) break;
      ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(iteration)), IsOk());
    }
  }

  const TempFolder temp_;
  const std::string logdir_ = temp_ / "runs/a";
  const ProgramInfo program_{"0.1.0", "39702b5", "digest1"};
  FakeClock clock_;
};

TEST_F(RunFolderTest, DescribesTheRun) {
  const auto folder = Create();
  ASSERT_NE(folder, nullptr);
  EXPECT_THAT(folder->run_id(), testing::MatchesRegex("20231114-221320-[0-9a-f]{6}"));
  EXPECT_EQ(folder->epoch(), 1);
  EXPECT_EQ(ReadFile(logdir_ + "/config.txt").value(), FormatRunConfig(folder->config()));
  EXPECT_EQ(nlohmann::json::parse(ReadFile(logdir_ + "/run.json").value()),
            nlohmann::json({{"run_id", folder->run_id()},
                            {"program_version", "0.1.0"},
                            {"git_revision", "39702b5"},
                            {"seed", 0},
                            {"texture_digest", "digest1"}}));
  EXPECT_THAT(ListFolder(logdir_).value(),
              ElementsAre("checkpoints", "config.txt", "epoch", "eval_argmax.jsonl", "eval_sampled.jsonl",
                          "events.out.tfevents.craftfleet", "final_argmax.jsonl", "final_sampled.jsonl", "lock",
                          "run.json", "stats.jsonl"));
}

TEST_F(RunFolderTest, ANewRunIsRefusedInAFolderWithARun) {
  ASSERT_NO_FATAL_FAILURE(MakeRun());
  const auto second = RunFolder::Create(logdir_, DefaultRunConfig(), program_, &clock_);
  EXPECT_THAT(second, StatusIs(absl::StatusCode::kAlreadyExists,
                               AllOf(HasSubstr(logdir_), HasSubstr("--resume"), HasSubstr("--logdir"))));
}

TEST_F(RunFolderTest, ARunWithoutACheckpointIsReplaced) {
  {
    const auto first = Create();
    first->AddEpisodes({SampleEpisode(100, 1)});
    ASSERT_THAT(first->FlushLogs(), IsOk());
  }
  const auto second = Create();
  ASSERT_NE(second, nullptr);
  EXPECT_EQ(ReadFile(logdir_ + "/stats.jsonl").value(), "");
}

TEST_F(RunFolderTest, RecordsTheOriginOfItsWeights) {
  const auto folder = RunFolder::Create(logdir_, DefaultRunConfig(), program_, &clock_, "run b after iteration 3");
  ASSERT_THAT(folder, IsOk());
  ASSERT_THAT((*folder)->Begin(), IsOk());
  EXPECT_EQ(nlohmann::json::parse(ReadFile(logdir_ + "/run.json").value())["init_from"], "run b after iteration 3");
}

TEST_F(RunFolderTest, AResumedRunCanKeepMoreCheckpoints) {
  ASSERT_NO_FATAL_FAILURE(MakeRun());
  auto run = Look();
  ASSERT_THAT(run, IsOk());
  v1::RunConfig config = run->folder->config();
  config.mutable_checkpoint()->set_keep(50);
  config.mutable_ppo()->set_gamma(0.5);
  run->folder->TakeChanges(config);
  ASSERT_THAT(run->folder->Begin(), IsOk());
  EXPECT_EQ(run->folder->config().checkpoint().keep(), 50);
  EXPECT_EQ(run->folder->config().ppo().gamma(), 0.95) << "nothing else changes";
  EXPECT_THAT(ReadFile(logdir_ + "/config.txt").value(), HasSubstr("keep: 50"));
}

TEST_F(RunFolderTest, AResumedRunCanBeExtended) {
  ASSERT_NO_FATAL_FAILURE(MakeRun());
  auto run = Look();
  ASSERT_THAT(run, IsOk());
  v1::RunConfig config = run->folder->config();
  config.set_steps(2'000'000);
  run->folder->TakeChanges(config);
  ASSERT_THAT(run->folder->Begin(), IsOk());
  EXPECT_EQ(run->folder->config().steps(), 2'000'000);
  EXPECT_THAT(ReadFile(logdir_ + "/config.txt").value(), HasSubstr("steps: 2000000"));
}

TEST_F(RunFolderTest, ASecondLearnerIsRefusedAndTheFirstIsNamed) {
  const auto first = Create();
  const auto matcher = StatusIs(absl::StatusCode::kFailedPrecondition,
                                HasSubstr(absl::StrCat("in use by process ", ::getpid(), " on ")));
  EXPECT_THAT(RunFolder::Create(logdir_, DefaultRunConfig(), program_, &clock_), matcher);
  EXPECT_THAT(Resume(), matcher);
}

TEST_F(RunFolderTest, ResumeGoesBackToTheCheckpoint) {
  MakeRun();
  const auto run = Resume();
  ASSERT_THAT(run, IsOk());
  EXPECT_EQ(run->checkpoint.state.iteration(), 2);
  EXPECT_EQ(run->folder->run_id(), run->checkpoint.state.run_id());
  EXPECT_EQ(run->folder->epoch(), 2);
  EXPECT_EQ(run->folder->config().lanes(), 16);
  EXPECT_EQ(run->folder->score().episodes(), 4);
  EXPECT_EQ(ReadFile(logdir_ + "/stats.jsonl").value(),
            absl::StrCat(FormatStatsLine(SampleEpisode(100, 1)), FormatStatsLine(SampleEpisode(10, 0)),
                         FormatStatsLine(SampleEpisode(200, 2)), FormatStatsLine(SampleEpisode(10, 0))));
}

TEST_F(RunFolderTest, AResumedRunWritesTheSameFilesAsAnUninterruptedOne) {
  MakeRun();
  const std::string stats = ReadFile(logdir_ + "/stats.jsonl").value();
  const std::string events = ReadFile(logdir_ + "/events.out.tfevents.craftfleet").value();
  auto run = Resume();
  ASSERT_THAT(run, IsOk());
  run->folder->AddEpisodes({SampleEpisode(300, 3), SampleEpisode(10, 0)});
  run->folder->AddScalars(4096 * 3, {{"train/reward", 3}});
  ASSERT_THAT(run->folder->FlushLogs(), IsOk());
  EXPECT_EQ(ReadFile(logdir_ + "/stats.jsonl").value(), stats);
  EXPECT_EQ(ReadFile(logdir_ + "/events.out.tfevents.craftfleet").value(), events);
}

TEST_F(RunFolderTest, TheRecordOfArrivalsIsTruncatedLikeTheOtherLogs) {
  v1::RunConfig config = DefaultRunConfig();
  config.set_max_staleness(2);
  config = ResolveRunConfig(config).value();
  const UpdateArrivals first = {0, {{{0, 0, 0}, 7}}};
  const UpdateArrivals second = {1, {{{0, 1, 0}, 8}}};
  {
    auto folder = RunFolder::Create(logdir_, config, program_, &clock_).value();
    ASSERT_THAT(folder->Begin(), IsOk());
    folder->AddArrivals(first);
    Checkpoint checkpoint = SampleCheckpoint(1);
    *checkpoint.state.mutable_config() = config;
    ASSERT_THAT(folder->WriteCheckpoint(checkpoint), IsOk());
    folder->AddArrivals(second);
    ASSERT_THAT(folder->FlushLogs(), IsOk());
  }
  EXPECT_EQ(ReadFile(logdir_ + "/arrivals.jsonl").value(), FormatArrivals(first) + FormatArrivals(second));
  ASSERT_THAT(Resume(), IsOk());
  EXPECT_EQ(ReadFile(logdir_ + "/arrivals.jsonl").value(), FormatArrivals(first));
  ASSERT_THAT(WriteFileSynced(logdir_ + "/arrivals.jsonl", "{"), IsOk());
  EXPECT_THAT(Look(), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("arrivals.jsonl has 1 bytes")));
}

TEST_F(RunFolderTest, ASynchronousRunHasNoRecordOfArrivals) {
  MakeRun();
  EXPECT_FALSE(PathExists(logdir_ + "/arrivals.jsonl"));
}

TEST_F(RunFolderTest, ResumingFromAnOlderCheckpointRemovesNewerOnes) {
  MakeRun();
  {
    const auto run = Resume({"iter-00000001", ""});
    ASSERT_THAT(run, IsOk());
    EXPECT_EQ(run->folder->score().episodes(), 2);
    EXPECT_THAT(run->folder->checkpoints().ListNewestFirst().value(), ElementsAre("iter-00000001"));
  }
  EXPECT_EQ(Resume().value().checkpoint.state.iteration(), 1);
}

// A start that fails for any reason after that must leave the folder unchanged.
TEST_F(RunFolderTest, CreateAndResumeChangeNothing) {
  MakeRun();
  // Possible leftovers of a killed learner.
  ASSERT_THAT(CreateFolders(logdir_ + "/checkpoints/.tmp-1-iter-00000003"), IsOk());
  const auto before = Contents();
  {
    const auto run = Look({"iter-00000001", ""});
    ASSERT_THAT(run, IsOk());
    EXPECT_EQ(run->folder->score().episodes(), 2);
    EXPECT_EQ(run->folder->epoch(), 2);
    EXPECT_EQ(Contents(), before);
  }
  ASSERT_THAT(Look(), IsOk());
  EXPECT_EQ(Contents(), before);
  EXPECT_THAT(RunFolder::Create(logdir_, DefaultRunConfig(), program_, &clock_),
              StatusIs(absl::StatusCode::kAlreadyExists, testing::_));
  EXPECT_EQ(Contents(), before);
}

TEST_F(RunFolderTest, ANewRunThatDoesNotBeginLeavesNothing) {
  ASSERT_THAT(RunFolder::Create(logdir_, ResolveRunConfig(DefaultRunConfig()).value(), program_, &clock_), IsOk());
  EXPECT_THAT(Contents(), testing::IsEmpty());
}

// The learner was killed while it replaced its newest checkpoint.
TEST_F(RunFolderTest, ResumeFindsACheckpointWhoseReplacementWasInterrupted) {
  MakeRun();
  const std::string folder = logdir_ + "/checkpoints/";
  ASSERT_THAT(RenameSynced(folder + "iter-00000002", folder + ".replaced-iter-00000002"), IsOk());
  const auto before = Contents();
  {
    const auto run = Look();
    ASSERT_THAT(run, IsOk());
    EXPECT_EQ(run->checkpoint.state.iteration(), 2);
    EXPECT_EQ(Contents(), before);
    ASSERT_THAT(run->folder->Begin(), IsOk());
  }
  EXPECT_TRUE(PathExists(folder + "iter-00000002"));
  EXPECT_FALSE(PathExists(folder + ".replaced-iter-00000002"));
}

// As on a shared disk where locks have no effect.
TEST_F(RunFolderTest, AnOlderLearnerWritesNothingOnceANewerHasBegun) {
  MakeRun();
  auto older = Resume();
  ASSERT_THAT(older, IsOk());
  EpochFence newer;
  ASSERT_THAT(newer.Take(logdir_, older->folder->epoch() + 1), IsOk());
  const auto before = Contents();
  older->folder->AddEpisodes({SampleEpisode(300, 3)});
  const auto taken_over = StatusIs(absl::StatusCode::kAborted, HasSubstr("taken over by process "));
  EXPECT_THAT(older->folder->FlushLogs(), taken_over);
  EXPECT_THAT(older->folder->WriteCheckpoint(SampleCheckpoint(3)), taken_over);
  EXPECT_THAT(older->folder->CheckOwned(), taken_over);
  EXPECT_EQ(Contents(), before);
}

TEST_F(RunFolderTest, OfTwoSimultaneousStartsTheSecondToBeginIsRefused) {
  MakeRun();
  auto run = Look();
  ASSERT_THAT(run, IsOk());
  EpochFence other;
  ASSERT_THAT(other.Take(logdir_, 2), IsOk());
  const auto before = Contents();
  EXPECT_THAT(run->folder->Begin(), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("was taken by")));
  EXPECT_EQ(Contents(), before);
}

TEST_F(RunFolderTest, ACheckpointDescribesTheRun) {
  MakeRun();
  const v1::CheckpointState state = Resume().value().checkpoint.state;
  EXPECT_EQ(state.program_version(), "0.1.0");
  EXPECT_EQ(state.texture_digest(), "digest1");
  EXPECT_EQ(state.config().agent(), "ppo_cnn");
  EXPECT_EQ(state.lanes(3).snapshot(), "snapshot of lane 3");
  // Means after the checkpoints: 0.5, then 0.75.
  EXPECT_EQ(state.best_score(), 0.75);
  std::vector<std::string> logs;
  for (const v1::LogLength& log : state.logs()) logs.push_back(log.file());
  EXPECT_THAT(logs, ElementsAre("events.out.tfevents.craftfleet", "stats.jsonl", "eval_argmax.jsonl",
                                "eval_sampled.jsonl", "final_argmax.jsonl", "final_sampled.jsonl"));
}

TEST_F(RunFolderTest, TheBestScoreNeverDecreases) {
  auto folder = Create();
  folder->AddEpisodes({SampleEpisode(10, 5)});
  ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(1)), IsOk());
  folder->AddEpisodes({SampleEpisode(10, 0)});
  ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(2)), IsOk());
  EXPECT_EQ(folder->checkpoints().LoadLatest("").value().state.best_score(), 5);
  folder.reset();
  auto run = Resume();
  ASSERT_THAT(run->folder->WriteCheckpoint(SampleCheckpoint(3)), IsOk());
  EXPECT_EQ(run->folder->checkpoints().LoadLatest("").value().state.best_score(), 5);
}

TEST_F(RunFolderTest, ResumeFailsWithoutARunOrACheckpoint) {
  EXPECT_THAT(Resume(), StatusIs(absl::StatusCode::kNotFound, HasSubstr("no run to resume in " + logdir_)));
  Create();
  EXPECT_THAT(Resume(), StatusIs(absl::StatusCode::kNotFound, HasSubstr("no checkpoint in " + logdir_)));
}

TEST_F(RunFolderTest, ResumingARunWithoutACheckpointSuggestsANewStart) {
  const auto is_told = StatusIs(absl::StatusCode::kNotFound, HasSubstr("start it again without --resume"));
  Create();
  EXPECT_THAT(Look(), is_told);
  EXPECT_THAT(Look({"iter-00000010", ""}), is_told);
  ASSERT_THAT(RemoveAll(logdir_ + "/checkpoints"), IsOk());  // killed even earlier
  EXPECT_THAT(Look(), is_told);
  EXPECT_NE(Create(), nullptr) << "a new start works";
}

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
    absl::StatusOr<ResumedRun> run = Look({from, ""});
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

// Version 0.1 did not set logs aside, and appended one final evaluation to the other.
TEST_F(FinishedRunTest, OnlyTheLinesOfTheCheckpointAreSetAside) {
  ASSERT_THAT(WriteFileSynced(logdir_ + "/final_argmax.jsonl", Lines(4096) + Lines(5000)), IsOk());
  ResumeTo(8192);
  EXPECT_EQ(Text("final_argmax.jsonl"), "");
  EXPECT_EQ(Text("final_argmax-4096.jsonl"), Lines(4096));
}

TEST_F(RunFolderTest, ARunOfOtherTexturesOrAnotherAgentIsRefused) {
  MakeRun();
  EXPECT_THAT(RunFolder::Resume(logdir_, {}, {"0.1.0", "39702b5", "digest2"}, &clock_),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("digest1"), HasSubstr("digest2"), HasSubstr("--textures"))));
  EXPECT_THAT(Resume({"", "oc_sa"}), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("oc_sa")));
  EXPECT_EQ(ReadEpoch(logdir_).value(), 1);
}

TEST_F(RunFolderTest, ALogThatLostBytesIsRefused) {
  MakeRun();
  ASSERT_EQ(::truncate((logdir_ + "/stats.jsonl").c_str(), 100), 0);
  EXPECT_THAT(Resume(), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("stats.jsonl has 100 bytes")));
}

// Every log ends complete, whichever of them had space at first.
TEST_F(RunFolderTest, AfterAFullDiskLogsAreWrittenInOrder) {
  const std::vector<std::string> files = {"stats.jsonl", "eval_argmax.jsonl", "eval_sampled.jsonl",
                                          "events.out.tfevents.craftfleet"};
  const auto add = [](RunFolder* folder, int64_t iteration) {
    folder->AddEpisodes({SampleEpisode(iteration, 1), SampleEpisode(iteration + 50, 2)});
    folder->AddScalars(iteration, {{"train/reward", 1.0}});
    if (iteration % 2 == 0) folder->AddEvaluation(false, {SampleEpisode(iteration, 3)}, {SampleEpisode(iteration, 4)});
  };
  const auto read = [&] {
    std::vector<std::string> contents;
    for (const std::string& file : files) contents.push_back(ReadFile(JoinPath(logdir_, file)).value());
    return contents;
  };
  {
    const auto untroubled = Create();
    for (int64_t iteration = 1; iteration <= 6; ++iteration) add(untroubled.get(), iteration);
    ASSERT_THAT(untroubled->FlushLogs(), IsOk());
  }
  const std::vector<std::string> wanted = read();

  const auto folder = Create();
  add(folder.get(), 1);
  ASSERT_THAT(folder->FlushLogs(), IsOk());
  const std::vector<std::string> before = read();
  {
    // Enough for the events, for a line of the evaluations' logs and for half a line of stats.jsonl.
    const FileSizeLimit limit(static_cast<int64_t>(before[0].size()) + 200);
    for (int64_t iteration = 2; iteration <= 5; ++iteration) {
      add(folder.get(), iteration);
      EXPECT_THAT(folder->FlushLogs(), StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("stats.jsonl")));
      EXPECT_EQ(read()[0], before[0]) << "no partial line";
    }
    EXPECT_THAT(folder->WriteCheckpoint(SampleCheckpoint(5)),
                StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("stats.jsonl")));
  }
  EXPECT_GT(folder->waiting_bytes(), 0);
  EXPECT_EQ(folder->score().episodes(), 10) << "the score is updated at once";
  add(folder.get(), 6);
  ASSERT_THAT(folder->FlushLogs(), IsOk());
  EXPECT_EQ(folder->waiting_bytes(), 0);
  EXPECT_EQ(read(), wanted);
  EXPECT_THAT(folder->WriteCheckpoint(SampleCheckpoint(6)), IsOk());
}

TEST_F(RunFolderTest, AFullDiskLeavesNoCheckpoint) {
  const auto folder = Create();
  {
    const FileSizeLimit limit(100);
    EXPECT_THAT(folder->WriteCheckpoint(SampleCheckpoint(1)),
                StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("state.pb")));
  }
  EXPECT_THAT(folder->checkpoints().ListNewestFirst().value(), testing::IsEmpty());
  EXPECT_THAT(folder->WriteCheckpoint(SampleCheckpoint(1)), IsOk());
}

TEST_F(RunFolderTest, EvaluationLogsAndScoresAreTruncatedOnResume) {
  {
    const auto folder = Create();
    folder->AddEvaluation(false, {SampleEpisode(1, 1)}, {SampleEpisode(2, 2), SampleEpisode(3, 3)});
    ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(1)), IsOk());
    folder->AddEvaluation(false, {SampleEpisode(4, 4)}, {SampleEpisode(5, 5)});
    folder->AddEvaluation(true, {SampleEpisode(6, 6)}, {SampleEpisode(7, 7)});
    ASSERT_THAT(folder->FlushLogs(), IsOk());
    EXPECT_EQ(folder->score(EpisodeKind::kFinalSampled).MeanReward(), 7);
    EXPECT_EQ(folder->score().episodes(), 0);
  }
  const auto run = Resume();
  ASSERT_THAT(run, IsOk());
  EXPECT_EQ(run->folder->score(EpisodeKind::kArgmax).episodes(), 1);
  EXPECT_EQ(run->folder->score(EpisodeKind::kSampled).MeanLength(), 2.5);
  EXPECT_EQ(run->folder->score(EpisodeKind::kFinalArgmax).episodes(), 0);
  EXPECT_EQ(ReadFile(logdir_ + "/eval_argmax.jsonl").value(), FormatStatsLine(SampleEpisode(1, 1)));
  EXPECT_EQ(ReadFile(logdir_ + "/final_sampled.jsonl").value(), "");
}

}  // namespace
}  // namespace craftfleet
