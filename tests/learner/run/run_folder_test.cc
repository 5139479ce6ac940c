#include "learner/run/run_folder.h"

#include <unistd.h>

#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "common/process/version.h"
#include "tests/fakes/file_size_limit.h"
#include "tests/learner/run/run_folder_fixture.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;

TEST_F(RunFolderTest, DescribesTheRun) {
  const auto folder = Create();
  ASSERT_NE(folder, nullptr);
  EXPECT_THAT(folder->run_id(), testing::MatchesRegex("20231114-221320-[0-9a-f]{6}"));
  EXPECT_EQ(folder->epoch(), 1);
  EXPECT_EQ(ReadFile(logdir_ + "/config.txt").value(), FormatRunConfig(folder->config()));
  EXPECT_EQ(nlohmann::json::parse(ReadFile(logdir_ + "/run.json").value()),
            nlohmann::json({{"run_id", folder->run_id()},
                            {"program_version", std::string(ProgramVersion())},
                            {"git_revision", std::string(GitRevision())},
                            {"seed", 0},
                            {"texture_digest", "digest1"}}));
  EXPECT_THAT(ListFolder(logdir_).value(),
              ElementsAre("checkpoints", "config.txt", "epoch", "eval_argmax.jsonl", "eval_sampled.jsonl",
                          "events.out.tfevents.craftfleet", "final_argmax.jsonl", "final_sampled.jsonl", "lock",
                          "run.json", "stats.jsonl"));
}

TEST_F(RunFolderTest, ANewRunIsRefusedInAFolderWithARun) {
  ASSERT_NO_FATAL_FAILURE(MakeRun());
  const auto second = RunFolder::Create(logdir_, DefaultRunConfig(), texture_digest_, &clock_);
  EXPECT_THAT(second, StatusIs(absl::StatusCode::kAlreadyExists,
                               AllOf(HasSubstr(logdir_), HasSubstr("--resume"), HasSubstr("--logdir"))));
}

TEST_F(RunFolderTest, ARunThatEndedBeforeItsFirstCheckpointIsReplaced) {
  const std::string first = Create()->run_id();
  ASSERT_THAT(RemoveAll(logdir_ + "/stats.jsonl"), IsOk());  // killed in Begin
  const auto second = Create();
  ASSERT_NE(second, nullptr);
  EXPECT_NE(second->run_id(), first);
  EXPECT_EQ(ReadFile(logdir_ + "/stats.jsonl").value(), "");
}

TEST_F(RunFolderTest, ARunThatLostItsCheckpointsIsNotOverwritten) {
  ASSERT_NO_FATAL_FAILURE(MakeRun());
  ASSERT_THAT(RenameSynced(logdir_ + "/checkpoints", temp_ / "away"), IsOk());
  const auto lost = [this](const std::string& reason) {
    const auto before = Contents();
    EXPECT_THAT(RunFolder::Create(logdir_, DefaultRunConfig(), texture_digest_, &clock_),
                StatusIs(absl::StatusCode::kAlreadyExists, AllOf(HasSubstr(reason), HasSubstr("another --logdir"))));
    EXPECT_THAT(Look().status().message(), HasSubstr(reason));
    EXPECT_TRUE(Contents() == before) << reason;
  };
  lost("stats.jsonl has ");
  ASSERT_THAT(CreateFolders(logdir_ + "/checkpoints"), IsOk());  // where a disk is not mounted
  lost("put its checkpoints back");
  ASSERT_THAT(RemoveAll(logdir_ + "/stats.jsonl"), IsOk());
  for (const char* log : {"/stats.jsonl.gz", "/weights.safetensors"}) {  // of an archived run, or of a result
    ASSERT_THAT(RenameSynced(logdir_ + "/events.out.tfevents.craftfleet", logdir_ + log), IsOk());
    lost(absl::StrCat(log, " has "));
    ASSERT_THAT(RenameSynced(logdir_ + log, logdir_ + "/events.out.tfevents.craftfleet"), IsOk());
  }
  lost("events.out.tfevents.craftfleet has ");
  ASSERT_THAT(RemoveAll(logdir_ + "/checkpoints"), IsOk());
  ASSERT_EQ(::symlink("nowhere", (logdir_ + "/checkpoints").c_str()), 0);
  lost("cannot list " + logdir_ + "/checkpoints: No such file or directory");
}

// A new run whose checkpoints are to be on another disk, which was away only when it began.
TEST_F(RunFolderTest, ALogIsRemovedOnlyOnceThereIsAPlaceForCheckpoints) {
  Create();
  auto folder = RunFolder::Create(logdir_, ResolveRunConfig(DefaultRunConfig()).value(), texture_digest_, &clock_);
  ASSERT_THAT(folder, IsOk());
  ASSERT_THAT(RemoveAll(logdir_ + "/checkpoints"), IsOk());
  ASSERT_EQ(::symlink("nowhere", (logdir_ + "/checkpoints").c_str()), 0);
  EXPECT_THAT((*folder)->Begin(), testing::Not(IsOk()));
  EXPECT_TRUE(PathExists(logdir_ + "/config.txt"));
  EXPECT_TRUE(PathExists(logdir_ + "/stats.jsonl"));
}

TEST_F(RunFolderTest, RecordsTheOriginOfItsWeights) {
  const auto folder =
      RunFolder::Create(logdir_, DefaultRunConfig(), texture_digest_, &clock_, "run b after iteration 3");
  ASSERT_THAT(folder, IsOk());
  ASSERT_THAT((*folder)->Begin(), IsOk());
  EXPECT_EQ(nlohmann::json::parse(ReadFile(logdir_ + "/run.json").value())["init_from"], "run b after iteration 3");
}

TEST_F(RunFolderTest, AResumedRunCanBeExtendedAndKeepMoreCheckpoints) {
  ASSERT_NO_FATAL_FAILURE(MakeRun());
  auto run = Look();
  ASSERT_THAT(run, IsOk());
  v1::RunConfig config = run->folder->config();
  config.set_steps(2'000'000);
  config.mutable_checkpoint()->set_keep(50);
  config.mutable_ppo()->set_gamma(0.5);
  run->folder->TakeChanges(config);
  ASSERT_THAT(run->folder->Begin(), IsOk());
  EXPECT_EQ(run->folder->config().steps(), 2'000'000);
  EXPECT_EQ(run->folder->config().checkpoint().keep(), 50);
  EXPECT_EQ(run->folder->config().ppo().gamma(), 0.95) << "nothing else changes";
  EXPECT_THAT(ReadFile(logdir_ + "/config.txt").value(), AllOf(HasSubstr("keep: 50"), HasSubstr("steps: 2000000")));
}

TEST_F(RunFolderTest, ASecondLearnerIsRefusedAndTheFirstIsNamed) {
  const auto first = Create();
  const auto matcher = StatusIs(absl::StatusCode::kFailedPrecondition,
                                HasSubstr(absl::StrCat("in use by process ", ::getpid(), " on ")));
  EXPECT_THAT(RunFolder::Create(logdir_, DefaultRunConfig(), texture_digest_, &clock_), matcher);
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

TEST_F(RunFolderTest, ResumingFromAnOlderCheckpointRemovesNewerOnes) {
  MakeRun();
  {
    const auto run = Resume("iter-00000001");
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
    const auto run = Look("iter-00000001");
    ASSERT_THAT(run, IsOk());
    EXPECT_EQ(run->folder->score().episodes(), 2);
    EXPECT_EQ(run->folder->epoch(), 2);
    EXPECT_EQ(Contents(), before);
  }
  ASSERT_THAT(Look(), IsOk());
  EXPECT_EQ(Contents(), before);
  EXPECT_THAT(RunFolder::Create(logdir_, DefaultRunConfig(), texture_digest_, &clock_),
              StatusIs(absl::StatusCode::kAlreadyExists, testing::_));
  EXPECT_EQ(Contents(), before);
}

TEST_F(RunFolderTest, ANewRunThatDoesNotBeginLeavesNothing) {
  ASSERT_THAT(RunFolder::Create(logdir_, ResolveRunConfig(DefaultRunConfig()).value(), texture_digest_, &clock_),
              IsOk());
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
  EXPECT_EQ(state.program_version(), ProgramVersion());
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
  EXPECT_EQ(folder->checkpoints().LoadLatest().value().state.best_score(), 5);
  folder.reset();
  auto run = Resume();
  ASSERT_THAT(run->folder->WriteCheckpoint(SampleCheckpoint(3)), IsOk());
  EXPECT_EQ(run->folder->checkpoints().LoadLatest().value().state.best_score(), 5);
}

// Otherwise the bytes of later checkpoints, and which one is kept, would depend on when a run was stopped.
TEST_F(RunFolderTest, ACheckpointOnRequestIsNeverTheBest) {
  every_iterations_ = 2;
  const auto folder = Create();
  folder->AddEpisodes({SampleEpisode(10, 5)});
  ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(1)), IsOk());
  folder->AddEpisodes({SampleEpisode(10, 0)});
  ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(2)), IsOk());
  EXPECT_EQ(folder->checkpoints().LoadLatest().value().state.best_score(), 2.5);
}

TEST_F(RunFolderTest, ARunThatLostItsConfigurationIsNotOverwritten) {
  ASSERT_NO_FATAL_FAILURE(MakeRun());
  ASSERT_THAT(RemoveAll(logdir_ + "/config.txt"), IsOk());
  const auto before = Contents();
  EXPECT_THAT(RunFolder::Create(logdir_, DefaultRunConfig(), texture_digest_, &clock_),
              StatusIs(absl::StatusCode::kAlreadyExists, HasSubstr("lost its config.txt: put back")));
  EXPECT_TRUE(Contents() == before);
}

TEST_F(RunFolderTest, ResumingARunWithoutACheckpointSuggestsANewStart) {
  EXPECT_THAT(Look(), StatusIs(absl::StatusCode::kNotFound, HasSubstr("no run to resume in " + logdir_)));
  const auto is_told = StatusIs(absl::StatusCode::kNotFound,
                                AllOf(HasSubstr("no checkpoint in " + logdir_),
                                      HasSubstr("ended before its first one; start it again without --resume")));
  Create();
  EXPECT_THAT(Look(), is_told);
  EXPECT_THAT(Look("iter-00000010"), is_told);
  ASSERT_THAT(RemoveAll(logdir_ + "/checkpoints"), IsOk());  // killed even earlier
  EXPECT_THAT(Look(), is_told);
  EXPECT_NE(Create(), nullptr) << "a new start works";
}

TEST_F(RunFolderTest, ARunOfOtherTexturesIsRefused) {
  MakeRun();
  EXPECT_THAT(RunFolder::Resume(logdir_, "", "digest2", &clock_),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("digest1"), HasSubstr("digest2"), HasSubstr("--textures"))));
  EXPECT_EQ(ReadEpoch(logdir_).value(), 1);
}

TEST_F(RunFolderTest, ALogThatLostLinesIsRefusedExceptForAnOlderCheckpoint) {
  MakeRun();
  const std::string first = FormatStatsLine(SampleEpisode(100, 1)) + FormatStatsLine(SampleEpisode(10, 0));
  ASSERT_EQ(::truncate((logdir_ + "/stats.jsonl").c_str(), static_cast<off_t>(first.size())), 0);
  EXPECT_THAT(
      Resume(),
      StatusIs(absl::StatusCode::kDataLoss,
               AllOf(HasSubstr(absl::StrCat("stats.jsonl has ", first.size(), " bytes, but the checkpoint expects")),
                     HasSubstr("go back to an older checkpoint with --resume_from"))));
  EXPECT_THAT(Resume("iter-00000001"), IsOk());
}

TEST_F(RunFolderTest, ACheckpointAfterALogWasCutCanBeResumedFrom) {
  {
    const auto folder = Create();
    ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(1)), IsOk());
    folder->AddEpisodes({SampleEpisode(100, 1)});
    folder->AddEvaluation(false, {SampleEpisode(1, 1)}, {});
    ASSERT_THAT(folder->FlushLogs(), IsOk());
    for (const char* log : {"/stats.jsonl", "/eval_argmax.jsonl"}) {
      ASSERT_EQ(::truncate((logdir_ + log).c_str(), 0), 0);
    }
    folder->AddEpisodes({SampleEpisode(200, 2)});  // and nothing to the other log
    testing::internal::CaptureStderr();
    ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(2)), IsOk());
    const auto told = [](const std::string& log, const std::string& lines) {
      return HasSubstr(absl::StrCat(log, " has 0 bytes, want the ", lines.size(), " that were written"));
    };
    EXPECT_THAT(testing::internal::GetCapturedStderr(),
                AllOf(told("error: " + logdir_ + "/stats.jsonl", FormatStatsLine(SampleEpisode(100, 1))),
                      told("error: " + logdir_ + "/eval_argmax.jsonl", FormatStatsLine(SampleEpisode(1, 1)))));
  }
  const auto run = Resume();
  ASSERT_THAT(run, IsOk());
  EXPECT_EQ(run->checkpoint.state.iteration(), 2);
  EXPECT_EQ(ReadFile(logdir_ + "/stats.jsonl").value(), FormatStatsLine(SampleEpisode(200, 2)));
}

// As by an editor, sed -i, rm or a copy that is put back.
TEST_F(RunFolderTest, ACheckpointAfterALogWasReplacedCanBeResumedFrom) {
  const std::string stats = logdir_ + "/stats.jsonl", argmax = logdir_ + "/eval_argmax.jsonl";
  const std::string first = FormatStatsLine(SampleEpisode(100, 1)), second = FormatStatsLine(SampleEpisode(200, 2));
  {
    const auto folder = Create();
    ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(1)), IsOk());
    folder->AddEpisodes({SampleEpisode(100, 1)});
    folder->AddEvaluation(false, {SampleEpisode(1, 1)}, {});
    ASSERT_THAT(folder->FlushLogs(), IsOk());
    ASSERT_THAT(ReplaceFile(stats, first), IsOk());
    ASSERT_THAT(RemoveAll(argmax), IsOk());
    folder->AddEpisodes({SampleEpisode(200, 2)});
    testing::internal::CaptureStderr();
    ASSERT_THAT(folder->WriteCheckpoint(SampleCheckpoint(2)), IsOk());
    const std::string log = testing::internal::GetCapturedStderr();
    for (const std::string& path : {stats, argmax}) {
      EXPECT_THAT(log, HasSubstr("error: " + path + " was replaced or removed by something else; the run goes on"));
    }
    EXPECT_THAT(log, AllOf(HasSubstr(argmax + " has 0 bytes"), testing::Not(HasSubstr(stats + " has "))));
  }
  const auto run = Resume();
  ASSERT_THAT(run, IsOk());
  EXPECT_EQ(run->checkpoint.state.iteration(), 2);
  EXPECT_EQ(ReadFile(stats).value(), first + second) << "a whole copy loses nothing";
  EXPECT_EQ(ReadFile(argmax).value(), "");
}

// As after cp -al.
TEST_F(RunFolderTest, ResumingAHardLinkedCopyLeavesTheOriginalUnchanged) {
  MakeRun();
  const auto before = Contents();
  std::filesystem::copy(logdir_, temp_ / "copy",
                        std::filesystem::copy_options::recursive | std::filesystem::copy_options::create_hard_links);
  {
    auto run = RunFolder::Resume(temp_ / "copy", "iter-00000001", texture_digest_, &clock_);
    ASSERT_THAT(run, IsOk());
    ASSERT_THAT(run->folder->Begin(), IsOk());
    run->folder->AddEpisodes({SampleEpisode(7, 7)});
    ASSERT_THAT(run->folder->WriteCheckpoint(SampleCheckpoint(2)), IsOk());
  }
  EXPECT_TRUE(Contents() == before);
  EXPECT_THAT(Resume(), IsOk());
}

TEST_F(RunFolderTest, TheNextStartRemovesLeftoversOfAKilledLearner) {
  MakeRun();
  ASSERT_THAT(WriteFileSynced(logdir_ + "/.craftfleet-12-3.tmp", "half"), IsOk());
  ASSERT_THAT(Resume(), IsOk());
  EXPECT_FALSE(PathExists(logdir_ + "/.craftfleet-12-3.tmp"));
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
  ASSERT_THAT(RemoveAll(logdir_), IsOk());

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
