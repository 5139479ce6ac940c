// Logs and checkpoints on a disk that fails a sync and loses unsynced data.

#include <unistd.h>

#include <memory>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/config.h"
#include "common/io/files.h"
#include "learner/run/append_file.h"
#include "learner/run/checkpoint_store.h"
#include "learner/run/run_folder.h"
#include "tests/fakes/dropping_disk.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/learner/run/run_samples.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

class FailedSyncTest : public testing::Test {
 protected:
  static void FailSync(const std::string& ending, int nth = 1) { DroppingDisk::Get().FailSync(ending, nth); }

  const TempFolder temp_;
};

TEST_F(FailedSyncTest, ALogIsRewrittenFromTheLastSync) {
  AppendFile file = AppendFile::Open(temp_ / "log").value();
  file.Append("one\n");
  ASSERT_THAT(file.Flush(), IsOk());
  ASSERT_THAT(file.Sync(), IsOk());
  for (const char* line : {"two\n", "three\n"}) {
    file.Append(line);
    ASSERT_THAT(file.Flush(), IsOk());
  }
  FailSync("/log");
  ASSERT_THAT(file.Sync(), Not(IsOk()));
  EXPECT_NE(ReadFile(temp_ / "log").value(), "one\ntwo\nthree\n") << "the disk has lost data";
  EXPECT_EQ(file.length(), 4) << "only synced data is trusted";
  EXPECT_EQ(file.waiting_bytes(), 10);
  file.Append("four\n");
  ASSERT_THAT(file.Flush(), IsOk());
  ASSERT_THAT(file.Sync(), IsOk());
  EXPECT_EQ(ReadFile(temp_ / "log").value(), "one\ntwo\nthree\nfour\n");
  EXPECT_EQ(file.length(), 19);
}

TEST_F(FailedSyncTest, ASyncThatFailsTwiceLosesNothing) {
  AppendFile file = AppendFile::Open(temp_ / "log").value();
  file.Append("one\n");
  for (int i = 0; i < 2; ++i) {
    ASSERT_THAT(file.Flush(), IsOk());
    FailSync("/log");
    ASSERT_THAT(file.Sync(), Not(IsOk()));
  }
  ASSERT_THAT(file.Flush(), IsOk());
  ASSERT_THAT(file.Sync(), IsOk());
  EXPECT_EQ(ReadFile(temp_ / "log").value(), "one\n");
}

TEST_F(FailedSyncTest, ALogCanBeTruncatedAfterwards) {
  AppendFile file = AppendFile::Open(temp_ / "log").value();
  file.Append("one\ntwo\n");
  ASSERT_THAT(file.Flush(), IsOk());
  ASSERT_THAT(file.TruncateTo(4), IsOk());
  FailSync("/log");
  ASSERT_THAT(file.Sync(), Not(IsOk()));
  EXPECT_EQ(file.waiting_bytes(), 4) << "truncated data does not reappear";
  ASSERT_THAT(file.Flush(), IsOk());
  EXPECT_EQ(ReadFile(temp_ / "log").value(), "one\n");
}

TEST_F(FailedSyncTest, DataThatSomethingElseCutOffIsNotCountedAsUnsynced) {
  AppendFile file = AppendFile::Open(temp_ / "log").value();
  file.Append("one\n");
  ASSERT_THAT(file.Flush(), IsOk());
  ASSERT_THAT(file.Sync(), IsOk());
  file.Append("two\n");
  ASSERT_THAT(file.Flush(), IsOk());
  ASSERT_EQ(::truncate((temp_ / "log").c_str(), 2), 0);
  FailSync("/log");
  ASSERT_THAT(file.Sync(), Not(IsOk()));
  EXPECT_EQ(file.length(), 2);
  EXPECT_EQ(file.waiting_bytes(), 0);
}

// The data kept for rewriting is bounded, since a growing log is synced regularly.
TEST_F(FailedSyncTest, AFastGrowingLogIsSyncedAutomatically) {
  AppendFile file = AppendFile::Open(temp_ / "log").value();
  const std::string part(400 << 10, 'x');
  FailSync("/log", 2);
  int flushes = 0;
  absl::Status status;
  while (status.ok() && ++flushes < 20) {
    file.Append(part);
    status = file.Flush();
  }
  EXPECT_EQ(flushes, 6) << "at every third flush";
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kUnknown, HasSubstr("cannot sync " + temp_ / "log")));
  EXPECT_EQ(file.waiting_bytes(), 3 * (400 << 10));
  ASSERT_THAT(file.Flush(), IsOk());
  EXPECT_EQ(ReadFile(temp_ / "log").value(), std::string(6 * (400 << 10), 'x'));
}

TEST_F(FailedSyncTest, AReplacedFileKeepsItsOldBytes) {
  ASSERT_THAT(ReplaceFile(temp_ / "config.txt", "old"), IsOk());
  FailSync(".tmp");
  EXPECT_THAT(ReplaceFile(temp_ / "config.txt", "new"), Not(IsOk()));
  EXPECT_EQ(ReadFile(temp_ / "config.txt").value(), "old");
  EXPECT_THAT(ReplaceFile(temp_ / "config.txt", "new"), IsOk());
  EXPECT_EQ(ReadFile(temp_ / "config.txt").value(), "new");
  EXPECT_THAT(ListFolder(temp_.path()).value(), ElementsAre("config.txt"));
}

// Every file and every folder entry is made to fail in turn.
TEST_F(FailedSyncTest, ACheckpointExistsOnlyOnceFullySynced) {
  for (const std::string ending :
       {"/weights.safetensors", "/optimizer.safetensors", "/state.pb", "/MANIFEST", "-iter-00000001", "/store"}) {
    SCOPED_TRACE(ending);
    ASSERT_THAT(RemoveAll(temp_ / "store"), IsOk());
    CheckpointStore store = CheckpointStore::Open(temp_ / "store").value();
    FailSync(ending);
    EXPECT_THAT(store.Write(SampleCheckpoint(1)), StatusIs(absl::StatusCode::kUnknown, HasSubstr("cannot sync")));
    EXPECT_TRUE(DroppingDisk::Get().failed());
    EXPECT_THAT(ListFolder(temp_ / "store").value(), IsEmpty());
    ASSERT_THAT(store.Write(SampleCheckpoint(1)), IsOk());
    EXPECT_EQ(*store.LoadLatest()->weights, *SampleCheckpoint(1).weights);
  }
}

TEST_F(FailedSyncTest, AFailedReplacementKeepsTheOldCheckpoint) {
  CheckpointStore store = CheckpointStore::Open(temp_ / "store").value();
  ASSERT_THAT(store.Write(SampleCheckpoint(1)), IsOk());
  Checkpoint evaluated = SampleCheckpoint(1);
  evaluated.state.set_final_evaluation_steps(4096);
  for (const int nth : {1, 2}) {  // renaming the old one away, renaming the new one into place
    SCOPED_TRACE(nth);
    FailSync("/store", nth);
    EXPECT_THAT(store.Write(evaluated), Not(IsOk()));
    EXPECT_THAT(ListFolder(temp_ / "store").value(), ElementsAre("iter-00000001"));
    EXPECT_EQ(store.LoadLatest()->state.final_evaluation_steps(), 0);
  }
  ASSERT_THAT(store.Write(evaluated), IsOk());
  EXPECT_EQ(store.LoadLatest()->state.final_evaluation_steps(), 4096);
}

TEST_F(FailedSyncTest, ARunResumesFromCompleteLogs) {
  const std::string logdir = temp_ / "run";
  FakeClock clock;
  std::string wanted;
  {
    auto folder = RunFolder::Create(logdir, ResolveRunConfig(DefaultRunConfig()).value(), "digest1", &clock).value();
    ASSERT_THAT(folder->Begin(), IsOk());
    for (int iteration = 1; iteration <= 3; ++iteration) {
      folder->AddEpisodes({SampleEpisode(iteration, 1)});
      wanted += FormatStatsLine(SampleEpisode(iteration, 1));
      ASSERT_THAT(folder->FlushLogs(), IsOk());
      FailSync("/stats.jsonl");
      EXPECT_THAT(folder->WriteCheckpoint(SampleCheckpoint(iteration)), Not(IsOk()));
      EXPECT_THAT(folder->WriteCheckpoint(SampleCheckpoint(iteration)), IsOk());
    }
  }
  EXPECT_EQ(ReadFile(logdir + "/stats.jsonl").value(), wanted);
  const auto run = RunFolder::Resume(logdir, "", "digest1", &clock);
  ASSERT_THAT(run, IsOk());
  EXPECT_EQ(run->folder->score().episodes(), 3);
}

}  // namespace
}  // namespace craftfleet
