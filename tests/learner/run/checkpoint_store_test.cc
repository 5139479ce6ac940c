#include "learner/run/checkpoint_store.h"

#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <filesystem>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_replace.h>
#include <gmock/gmock.h>
#include <google/protobuf/util/message_differencer.h>
#include <gtest/gtest.h>

#include "common/base/crc32c.h"
#include "common/io/files.h"
#include "tests/fakes/file_size_limit.h"
#include "tests/fakes/plain_user.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

using google::protobuf::util::MessageDifferencer;
using testing::AllOf;
using testing::ElementsAre;
using testing::EndsWith;
using testing::HasSubstr;
using testing::Not;

class CheckpointStoreTest : public testing::Test {
 protected:
  void Write(int64_t iteration, double best_score = 0) {
    ASSERT_THAT(store_.Write(SampleCheckpoint(iteration, best_score)), IsOk());
  }
  std::vector<std::string> Names() { return store_.ListNewestFirst().value(); }
  std::string PathOf(int64_t iteration, const std::string& file) {
    return temp_ / absl::StrCat(CheckpointName(iteration), "/", file);
  }
  // Replaces text in a file of checkpoint `iteration`.
  void Edit(int64_t iteration, const std::string& file, const std::string& from, const std::string& to) {
    const std::string text = ReadFile(PathOf(iteration, file)).value();
    ASSERT_THAT(text, HasSubstr(from));
    ASSERT_THAT(WriteFileSynced(PathOf(iteration, file), absl::StrReplaceAll(text, {{from, to}})), IsOk());
  }
  // Writes `bytes` to `file` and updates the manifest.
  void Forge(int64_t iteration, const std::string& file, const std::string& bytes) {
    const auto line = [&](const std::string& content) {
      return absl::StrFormat("%s %d %08x", file, content.size(), Crc32c(content));
    };
    Edit(iteration, "MANIFEST", line(ReadFile(PathOf(iteration, file)).value()), line(bytes));
    ASSERT_THAT(WriteFileSynced(PathOf(iteration, file), bytes), IsOk());
  }

  const TempFolder temp_;
  CheckpointStore store_ = CheckpointStore::Open(temp_.path()).value();
};

TEST_F(CheckpointStoreTest, LoadsWhatWasWritten) {
  const Checkpoint written = SampleCheckpoint(10, 2.5);
  ASSERT_THAT(store_.Write(written), IsOk());
  const auto loaded = store_.Load("iter-00000010");
  ASSERT_THAT(loaded, IsOk());
  EXPECT_EQ(*loaded->weights, *written.weights);
  EXPECT_EQ(loaded->optimizer, written.optimizer);
  v1::CheckpointState state = written.state;
  state.set_format(kCheckpointFormat);
  EXPECT_TRUE(MessageDifferencer::Equals(loaded->state, state));
}

// Of a run with overlap and the least ppo.value_norm_start, before its first update.
TEST_F(CheckpointStoreTest, LoadsPlayWeightsOfAnyValueNormStart) {
  Checkpoint written = SampleCheckpoint(1);
  written.play_weights = std::make_shared<const std::string>("play");
  for (const double start : {std::numeric_limits<double>::denorm_min(), 1e-40, 100.0}) {
    written.state.set_iteration(written.state.iteration() + 1);
    written.state.mutable_config()->mutable_ppo()->set_value_norm_start(start);
    written.state.mutable_play()->set_value_deviation(start);
    ASSERT_THAT(store_.Write(written), IsOk());
    EXPECT_THAT(store_.LoadLatest(), IsOk()) << start;
  }
}

TEST_F(CheckpointStoreTest, TheManifestIsText) {
  Write(10);
  const std::string manifest = ReadFile(PathOf(10, "MANIFEST")).value();
  EXPECT_THAT(manifest, testing::MatchesRegex("craftfleet checkpoint, format 2\n"
                                              "program 0.2.0\n"
                                              "state.pb [0-9]+ [0-9a-f]+\n"
                                              "weights.safetensors 3010 [0-9a-f]+\n"
                                              "optimizer.safetensors 14 [0-9a-f]+\n"));
}

TEST_F(CheckpointStoreTest, KeepsTheNewestThreeAndTheBest) {
  Write(10, 1.0);
  EXPECT_THAT(Names(), ElementsAre("iter-00000010"));
  Write(20, 3.0);  // the best from here on
  Write(30, 3.0);
  Write(40, 3.0);
  Write(50, 3.0);
  EXPECT_THAT(Names(), ElementsAre("iter-00000050", "iter-00000040", "iter-00000030", "iter-00000020"));
  Write(60, 3.0);
  EXPECT_THAT(Names(), ElementsAre("iter-00000060", "iter-00000050", "iter-00000040", "iter-00000020"));
  Write(70, 3.5);
  EXPECT_THAT(Names(), ElementsAre("iter-00000070", "iter-00000060", "iter-00000050"));
  EXPECT_THAT(ListFolder(temp_.path()).value(), testing::SizeIs(3));
}

TEST_F(CheckpointStoreTest, WithoutEpisodesThereIsNoBest) {
  for (int64_t iteration = 0; iteration < 5; ++iteration) Write(iteration, -std::numeric_limits<double>::infinity());
  EXPECT_THAT(Names(), ElementsAre("iter-00000004", "iter-00000003", "iter-00000002"));
}

TEST_F(CheckpointStoreTest, OrdersByNumberNotByText) {
  Write(99'999'999);
  Write(100'000'000);
  EXPECT_THAT(Names(), ElementsAre("iter-100000000", "iter-99999999"));
  EXPECT_EQ(store_.LoadLatest().value().state.iteration(), 100'000'000);
}

TEST_F(CheckpointStoreTest, ATornCheckpointIsNamedWithTheNewestValidOne) {
  Write(10);
  Write(20);
  Write(30);
  const std::string weights = ReadFile(PathOf(30, "weights.safetensors")).value();
  ASSERT_THAT(WriteFileSynced(PathOf(30, "weights.safetensors"), weights.substr(0, 1000)), IsOk());
  EXPECT_THAT(store_.LoadLatest(),
              StatusIs(absl::StatusCode::kDataLoss,
                       testing::StrEq("checkpoint " + temp_ / "iter-00000030" +
                                      " is torn: weights.safetensors has 1000 of 3010 bytes; the newest valid one is "
                                      "iter-00000020: resume from it with --resume_from=iter-00000020")));
  EXPECT_THAT(store_.Load("iter-00000020"), IsOk());
}

TEST_F(CheckpointStoreTest, OnlyAValidCheckpointIsOffered) {
  Write(10);
  Write(20);
  Write(30);
  ASSERT_THAT(RemoveAll(PathOf(20, "state.pb")), IsOk());
  ASSERT_THAT(RemoveAll(PathOf(30, "optimizer.safetensors")), IsOk());
  EXPECT_THAT(store_.LoadLatest(), StatusIs(absl::StatusCode::kDataLoss,
                                            AllOf(HasSubstr("iter-00000030 is torn: optimizer.safetensors is missing"),
                                                  EndsWith("--resume_from=iter-00000010"))));
  ASSERT_THAT(RemoveAll(PathOf(10, "state.pb")), IsOk());
  EXPECT_THAT(store_.LoadLatest(), StatusIs(absl::StatusCode::kDataLoss, Not(HasSubstr("resume_from"))));
}

// Otherwise a run that resumes from it would delete it, and 20 too: both have a higher name than its iteration.
TEST_F(CheckpointStoreTest, ACheckpointUnderAFalseNameIsRefused) {
  Write(10);
  Write(20);
  std::filesystem::copy(temp_ / "iter-00000010", temp_ / "iter-00000099");
  const std::string refusal = "checkpoint " + temp_ / "iter-00000099" +
                              " has the state after iteration 10: rename it to iter-00000010, or move it elsewhere";
  EXPECT_THAT(store_.LoadLatest(),
              StatusIs(absl::StatusCode::kDataLoss,
                       testing::StrEq(refusal + "; the newest valid one is iter-00000020: resume from it with "
                                                "--resume_from=iter-00000020")));
  EXPECT_THAT(store_.Load("iter-00000099"), StatusIs(absl::StatusCode::kDataLoss, testing::StrEq(refusal)));
  EXPECT_THAT(Names(), ElementsAre("iter-00000099", "iter-00000020", "iter-00000010"));
  Write(99);
  EXPECT_EQ(store_.LoadLatest().value().state.iteration(), 99) << "its own name is free for the run";
}

TEST_F(CheckpointStoreTest, ACheckpointUnderAFalseNameIsNotOffered) {
  for (const int iteration : {10, 20, 30}) Write(iteration);
  ASSERT_THAT(RenameSynced(temp_ / "iter-00000010", temp_ / "iter-00000025"), IsOk());
  ASSERT_THAT(RemoveAll(PathOf(30, "state.pb")), IsOk());
  EXPECT_THAT(store_.LoadLatest(), StatusIs(absl::StatusCode::kDataLoss, EndsWith("--resume_from=iter-00000020")));
}

TEST_F(CheckpointStoreTest, AFlippedBitIsDetected) {
  Write(10);
  Edit(10, "weights.safetensors", "weights 10", "weights 11");
  EXPECT_THAT(store_.LoadLatest(),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("is torn: weights.safetensors has checksum ")));
}

TEST_F(CheckpointStoreTest, ATruncatedManifestIsTorn) {
  Write(10);
  const std::string manifest = ReadFile(PathOf(10, "MANIFEST")).value();
  const auto load_cut = [&](size_t length) {
    EXPECT_THAT(WriteFileSynced(PathOf(10, "MANIFEST"), manifest.substr(0, length)), IsOk());
    return store_.LoadLatest().status();
  };
  constexpr auto kDataLoss = absl::StatusCode::kDataLoss;
  EXPECT_THAT(load_cut(manifest.find("program") + 3),
              StatusIs(kDataLoss, HasSubstr("MANIFEST has no program version")));
  EXPECT_THAT(load_cut(manifest.find("weights")), StatusIs(kDataLoss, HasSubstr("does not list weights.safetensors")));
  EXPECT_THAT(load_cut(manifest.size() - 4), StatusIs(kDataLoss, HasSubstr("optimizer.safetensors has checksum")));
  EXPECT_THAT(load_cut(0), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is not a checkpoint")));
}

TEST_F(CheckpointStoreTest, AnotherFormatIsRefusedWithTheVersionThatWroteItAndWhatToDo) {
  Write(10);
  const auto refused = [&](const std::string& text, const std::string& advice) {
    EXPECT_THAT(store_.LoadLatest(),
                StatusIs(absl::StatusCode::kFailedPrecondition, AllOf(HasSubstr(text), HasSubstr(advice))));
  };
  Edit(10, "MANIFEST", "format 2\nprogram 0.2.0", "format 3\nprogram 3.1.4");
  refused("has format 3, written by craftfleet 3.1.4", "this program reads format 2: use that version or a newer one");
  Edit(10, "MANIFEST", "format 3\nprogram 3.1.4", "format 1\nprogram 0.1.0");
  refused("has format 1, written by craftfleet 0.1.0", "finish the run with that version, or start a new one");
}

TEST_F(CheckpointStoreTest, AnInvalidStateIsRefused) {
  Write(10);
  Forge(10, "state.pb", "\xFF\xFF\xFF garbage");
  EXPECT_THAT(store_.LoadLatest(),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("state.pb is not a CheckpointState")));
  v1::CheckpointState state = SampleCheckpoint(10).state;
  state.mutable_lanes()->RemoveLast();
  Forge(10, "state.pb", state.SerializeAsString());
  EXPECT_THAT(store_.LoadLatest(),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("has 15 lanes, its configuration 16")));
  state = SampleCheckpoint(10).state;
  state.mutable_config()->mutable_ppo()->set_gamma(7);
  Forge(10, "state.pb", state.SerializeAsString());
  EXPECT_THAT(store_.LoadLatest(), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("ppo.gamma is 7")));
  state = SampleCheckpoint(10).state;
  state.set_env_steps(-1);
  Forge(10, "state.pb", state.SerializeAsString());
  EXPECT_THAT(store_.LoadLatest(), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("env_steps is -1, want 0..")));
}

TEST_F(CheckpointStoreTest, AnEmptyStoreOrAnUnknownNameIsNotFound) {
  EXPECT_THAT(store_.LoadLatest(), StatusIs(absl::StatusCode::kNotFound, HasSubstr(temp_.path())));
  Write(10);
  Write(20);
  EXPECT_THAT(store_.Load("iter-00000011"),
              StatusIs(absl::StatusCode::kNotFound, AllOf(HasSubstr("no checkpoint iter-00000011"),
                                                          EndsWith("which has iter-00000020, iter-00000010"))));
  EXPECT_THAT(store_.Load("../x"), StatusIs(absl::StatusCode::kNotFound, HasSubstr("../x")));
}

TEST_F(CheckpointStoreTest, AFullDiskLeavesOnlyEarlierCheckpoints) {
  Write(10);
  {
    const FileSizeLimit limit(2000);  // the state fits, the weights do not
    EXPECT_THAT(store_.Write(SampleCheckpoint(20)),
                StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("weights.safetensors")));
  }
  EXPECT_THAT(ListFolder(temp_.path()).value(), ElementsAre("iter-00000010"));
  EXPECT_EQ(store_.LoadLatest().value().state.iteration(), 10);
  Write(20);
  EXPECT_EQ(store_.LoadLatest().value().state.iteration(), 20);
}

TEST_F(CheckpointStoreTest, ACheckpointIsWrittenWhereOlderOnesCannotBeListed) {
  ASSERT_EQ(::chmod(temp_.path().c_str(), 0333), 0);
  testing::internal::CaptureStderr();
  {
    const PlainUser user;
    EXPECT_THAT(store_.Write(SampleCheckpoint(10)), IsOk());
  }
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              AllOf(HasSubstr("warning: cannot list " + temp_.path()), HasSubstr("the next checkpoint tries again")));
  ASSERT_EQ(::chmod(temp_.path().c_str(), 0700), 0);
  EXPECT_THAT(ListFolder(temp_.path()).value(), ElementsAre("iter-00000010"));
}

TEST_F(CheckpointStoreTest, OnlyATornCheckpointOfTheSameIterationIsReplaced) {
  Write(10, 1.0);
  Write(10, 2.0);
  EXPECT_EQ(store_.LoadLatest().value().state.best_score(), 1.0);
  ASSERT_THAT(RemoveAll(PathOf(10, "state.pb")), IsOk());
  Write(10, 2.0);
  EXPECT_EQ(store_.LoadLatest().value().state.best_score(), 2.0);
}

// It may be a good one that could not be read just now, as with too many open files.
TEST_F(CheckpointStoreTest, ACheckpointThatCannotBeLoadedStaysUntilAnotherReplacesIt) {
  Write(10);
  ASSERT_THAT(RemoveAll(PathOf(10, "state.pb")), IsOk());
  const FileSizeLimit limit(2000);  // the state fits, the weights do not
  EXPECT_THAT(store_.Write(SampleCheckpoint(10)),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("weights.safetensors")));
  EXPECT_THAT(ListFolder(temp_.path()).value(), ElementsAre("iter-00000010"));
}

TEST_F(CheckpointStoreTest, ACheckpointIsReplacedIfTheRunWasEvaluatedSince) {
  Checkpoint waiting = SampleCheckpoint(10, 1.0);
  v1::PendingEvaluation* pending = waiting.state.add_pending();
  pending->set_number(3);
  pending->set_first_episode(21);
  pending->set_episodes(5);
  waiting.evaluation_weights = {std::make_shared<std::string>("weights of then")};
  ASSERT_THAT(store_.Write(waiting), IsOk());
  const Checkpoint loaded = store_.LoadLatest().value();
  ASSERT_EQ(loaded.evaluation_weights.size(), 1u);
  EXPECT_EQ(*loaded.evaluation_weights[0], "weights of then");
  EXPECT_EQ(loaded.state.pending(0).first_episode(), 21);

  Write(10, 2.0);
  EXPECT_EQ(store_.LoadLatest().value().state.pending_size(), 0);
  EXPECT_THAT(ListFolder(temp_.path()).value(), ElementsAre("iter-00000010"));
}

TEST_F(CheckpointStoreTest, AKillDuringAReplacementLeavesOneCheckpoint) {
  Write(10);
  ASSERT_EQ(std::rename((temp_ / "iter-00000010").c_str(), (temp_ / ".replaced-iter-00000010").c_str()), 0);
  ASSERT_THAT(CheckpointStore::Open(temp_.path()), IsOk());
  EXPECT_THAT(ListFolder(temp_.path()).value(), ElementsAre("iter-00000010")) << "the old one is back";
  ASSERT_THAT(CreateFolders(temp_ / ".replaced-iter-00000010"), IsOk());
  ASSERT_THAT(CheckpointStore::Open(temp_.path()), IsOk());
  EXPECT_THAT(ListFolder(temp_.path()).value(), ElementsAre("iter-00000010")) << "the new one was there already";
  EXPECT_THAT(store_.LoadLatest(), IsOk());
}

TEST_F(CheckpointStoreTest, TheNextStartRemovesLeftoversOfAKilledWriter) {
  Write(10);
  ASSERT_THAT(CreateFolders(temp_ / ".tmp-iter-00000020"), IsOk());
  ASSERT_THAT(WriteFileSynced(temp_ / ".tmp-iter-00000020/state.pb", "half"), IsOk());
  EXPECT_THAT(Names(), ElementsAre("iter-00000010"));
  ASSERT_THAT(CheckpointStore::Open(temp_.path()), IsOk());
  EXPECT_THAT(ListFolder(temp_.path()).value(), ElementsAre("iter-00000010"));
}

TEST_F(CheckpointStoreTest, DiscardsCheckpointsOfLaterIterations) {
  Write(10);
  Write(20);
  Write(30);
  ASSERT_THAT(store_.DiscardNewerThan(10), IsOk());
  EXPECT_THAT(ListFolder(temp_.path()).value(), ElementsAre("iter-00000010"));
}

TEST_F(CheckpointStoreTest, TheNewestCheckpointIsCompleteAfterAKill) {
  constexpr int kRounds = 20;
  Write(1);
  int64_t newest = 1;
  for (int round = 0; round < kRounds; ++round) {
    const pid_t writer = ::fork();
    ASSERT_GE(writer, 0);
    if (writer == 0) {
      for (int64_t iteration = newest + 1;; ++iteration) {
        if (!store_.Write(SampleCheckpoint(iteration)).ok()) ::_exit(1);
      }
    }
    ::usleep(500 + 1700 * round);  // so that kills hit at many places
    const bool is_last = round + 1 == kRounds;
    while (is_last && newest == 1 && !PathExists(temp_ / "iter-00000002")) ::usleep(1000);  // on a slow disk
    ASSERT_EQ(::kill(writer, SIGKILL), 0);
    int status = 0;
    ASSERT_EQ(::waitpid(writer, &status, 0), writer);
    ASSERT_TRUE(WIFSIGNALED(status));
    store_ = CheckpointStore::Open(temp_.path()).value();
    const auto loaded = store_.LoadLatest();
    ASSERT_THAT(loaded, IsOk());
    EXPECT_GE(loaded->state.iteration(), newest);
    newest = loaded->state.iteration();
  }
  EXPECT_GT(newest, 1);
}

TEST(FindCheckpoint, AcceptsACheckpointOrARunFolder) {
  const TempFolder run;
  CheckpointStore store = CheckpointStore::Open(run / "checkpoints").value();
  EXPECT_THAT(FindCheckpoint(run.path()), StatusIs(absl::StatusCode::kNotFound, HasSubstr(run.path())));
  ASSERT_THAT(store.Write(SampleCheckpoint(10)), IsOk());
  ASSERT_THAT(store.Write(SampleCheckpoint(20)), IsOk());
  EXPECT_EQ(FindCheckpoint(run.path()).value(), run / "checkpoints/iter-00000020");
  EXPECT_EQ(FindCheckpoint(run / "checkpoints").value(), run / "checkpoints/iter-00000020");
  EXPECT_EQ(FindCheckpoint(run / "checkpoints/iter-00000010").value(), run / "checkpoints/iter-00000010");
}

TEST(FindCheckpoint, CheckpointsThatAreAwayAreNotTakenForNone) {
  const TempFolder run;
  ASSERT_EQ(::symlink("nowhere", (run / "checkpoints").c_str()), 0);
  const std::string reason = "cannot list " + run / "checkpoints" + ": ";
  EXPECT_THAT(FindCheckpoint(run.path()), StatusIs(absl::StatusCode::kUnavailable, HasSubstr(reason)));
  ASSERT_THAT(RemoveAll(run / "checkpoints"), IsOk());
  ASSERT_THAT(WriteFileSynced(run / "checkpoints", ""), IsOk());
  EXPECT_THAT(FindCheckpoint(run.path()).status().message(), HasSubstr(reason + "Not a directory"));
  EXPECT_THAT(FindCheckpoint(run / "checkpoints"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("no checkpoint at")));
}

TEST(LoadFound, NamesTheNewestValidCheckpointOfARunWhoseNewestIsTorn) {
  const TempFolder run;
  CheckpointStore store = CheckpointStore::Open(run / "checkpoints").value();
  for (const int iteration : {10, 20, 30}) ASSERT_THAT(store.Write(SampleCheckpoint(iteration)), IsOk());
  std::string folder;
  EXPECT_EQ(LoadFound(run.path(), &folder)->state.iteration(), 30);
  EXPECT_EQ(folder, run / "checkpoints/iter-00000030");
  ASSERT_THAT(WriteFileSynced(run / "checkpoints/iter-00000030/weights.safetensors", "torn"), IsOk());
  EXPECT_THAT(LoadFound(run.path(), &folder),
              StatusIs(absl::StatusCode::kDataLoss,
                       HasSubstr("; the newest valid one is " + (run / "checkpoints/iter-00000020") + ": give that")));
  EXPECT_THAT(LoadFound(run / "checkpoints/iter-00000030", &folder),
              StatusIs(absl::StatusCode::kDataLoss, Not(HasSubstr("newest valid"))))
      << "it was asked for by name";
}

}  // namespace
}  // namespace craftfleet
