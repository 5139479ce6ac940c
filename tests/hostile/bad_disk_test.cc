// Learners on disks without working locks, or that lose synced data.

#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_replace.h>
#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "tests/fakes/test_paths.h"
#include "tests/fakes/wait_until.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::ContainsRegex;
using testing::HasSubstr;

class BadDiskTest : public SmallRunTest {
 protected:
  // A program with the simulated disk `disk` (bad_disk.cc).
  std::unique_ptr<Process> StartOn(const std::string& disk, const std::string& program,
                                   const std::vector<std::string>& flags) {
    const char* const asan = std::getenv("ASAN_OPTIONS");
    std::vector<std::string> words = {
        absl::StrCat("LD_PRELOAD=", BuiltProgram("libcraftfleet_bad_disk.so")), "BAD_DISK=" + disk,
        // AddressSanitizer wants to be the first library itself.
        absl::StrCat("ASAN_OPTIONS=verify_asan_link_order=0:", asan != nullptr ? asan : "")};
    const std::vector<std::string> command = BuiltCommand(program);
    words.insert(words.end(), command.begin(), command.end());
    words.insert(words.end(), flags.begin(), flags.end());
    return Start("/usr/bin/env", words);
  }
  void StartWorker(const std::string& learner) {
    if (server_ == nullptr) server_ = Start("craftfleet-envserver", {"--listen=127.0.0.1:0"});
    actors_.push_back(
        Start("craftfleet-actor", {"--learner=" + learner, "--envservers=" + server_->WaitForAddress().value()}));
  }
  // Expects the same bytes as those of an undisturbed run of `iterations`.
  void ExpectLikeQuiet(int iterations) {
    CopyTrained("quiet");
    EXPECT_EQ(Text("run", "stats.jsonl"), Text("quiet", "stats.jsonl"));
    for (const char* name : {"weights", "optimizer"}) {
      const std::string file = absl::StrFormat("checkpoints/iter-%08d/%s.safetensors", iterations, name);
      EXPECT_NE(Text("quiet", file), "none");
      EXPECT_TRUE(Text("run", file) == Text("quiet", file)) << file;
    }
  }

  std::unique_ptr<Process> server_;
  std::vector<std::unique_ptr<Process>> actors_;
};

// The older learner is suspended while it trains with an actor, and goes on once the newer one has resumed the run.
TEST_F(BadDiskTest, OfTwoLearnersWithoutLocksOnlyTheNewerWrites) {
  ASSERT_THAT(WriteFileSynced(config(), absl::StrReplaceAll(kConfig, {{"steps: 192", "steps: 1920"}})), IsOk());
  const std::vector<std::string> flags = Flags("run", {"--listen=127.0.0.1:0", "--autoresume"});
  const auto older = StartOn("nolocks", "craftfleet-learner", flags);
  StartWorker(older->WaitForAddress().value());
  ASSERT_TRUE(WaitUntil([this] { return PathExists(Checkpoint("run", 3)); }, kPatience)) << older->Err();
  older->Signal(SIGSTOP);  // or it might end before the newer one has started

  const auto newer = StartOn("nolocks", "craftfleet-learner", flags);
  StartWorker(newer->WaitForAddress().value());
  older->Signal(SIGCONT);
  Ended ended = Finish(older.get());
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr(absl::StrCat("was taken over by process ", newer->pid(), " on ")));
  EXPECT_THAT(ended.err, HasSubstr("(epoch 2, this one is epoch 1)"));

  ended = Finish(newer.get());
  EXPECT_EQ(ended.exit_code, 0) << ended.err;
  const std::vector<std::string> lines = absl::StrSplit(Text("run", "stats.jsonl"), '\n', absl::SkipEmpty());
  EXPECT_GT(lines.size(), 0U);
  for (const std::string& line : lines) EXPECT_TRUE(nlohmann::json::accept(line)) << line;
  ExpectLikeQuiet(30);
}

// An older learner without actors must not wait forever either.
TEST_F(BadDiskTest, AnOlderLearnerWithoutActorsEndsToo) {
  const std::vector<std::string> flags = Flags("run", {"--listen=127.0.0.1:0", "--autoresume"});
  const auto older = StartOn("nolocks", "craftfleet-learner", flags);
  ASSERT_TRUE(WaitUntil([this] { return PathExists(Checkpoint("run", 0)); }, kPatience));
  const auto newer = StartOn("nolocks", "craftfleet-learner", flags);
  const Ended ended = Finish(older.get());
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("was taken over by process "));
}

TEST_F(BadDiskTest, ALogOrCheckpointThatCouldNotBeSyncedIsWrittenAgain) {
  // The first sync of each file belongs to the initial checkpoint, the second to that of the first iteration.
  for (const std::string file : {"/stats.jsonl", "/weights.safetensors"}) {
    for (const char* run : {"run", "quiet"}) ASSERT_THAT(RemoveAll(Logdir(run)), IsOk());
    const Ended ended = Finish(StartOn(file + ":2", "craftfleet train", Flags("run")).get());
    EXPECT_EQ(ended.exit_code, 0) << ended.err;
    EXPECT_THAT(ended.err, ContainsRegex("checkpoint of iteration 1: cannot sync " + Logdir("run") + ".*" + file));
    EXPECT_FALSE(PathExists(Checkpoint("run", 1))) << file;
    ExpectLikeQuiet(3);
  }
}

TEST_F(BadDiskTest, FoldersThatCannotBeSyncedAreNoError) {
  for (const char* program : {"craftfleet train", "craftfleet curve", "craftfleet eval"}) {
    std::vector<std::string> flags = Flags("run");
    if (program == std::string("craftfleet curve")) flags = {Logdir("run"), "--out=" + folder_ / "curve.png"};
    if (program == std::string("craftfleet eval")) {
      flags = {"--checkpoint=" + Logdir("run"), "--episodes=1", "--out=" + folder_ / "eval.json"};
    }
    const Ended ended = Finish(StartOn("nofoldersync", program, flags).get());
    EXPECT_EQ(ended.exit_code, 0) << program << ": " << ended.err;
  }
  EXPECT_TRUE(PathExists(folder_ / "curve.png"));
  EXPECT_TRUE(PathExists(folder_ / "eval.json"));
  ExpectLikeQuiet(3);
}

TEST_F(BadDiskTest, ADiskWithoutLocksIsWarnedOfAndUsed) {
  for (const int error : {ENOSYS, ENOLCK, EOPNOTSUPP}) {
    const std::string run = absl::StrCat("run-", error);
    const Ended ended = Finish(StartOn(absl::StrCat("flock=", error), "craftfleet train", Flags(run)).get());
    EXPECT_EQ(ended.exit_code, 0) << ended.err;
    EXPECT_THAT(ended.err, HasSubstr(Logdir(run) + ": the file system has no locks ("));
    EXPECT_THAT(ended.err, HasSubstr("do not start a second process with this --logdir"));
  }
}

TEST_F(BadDiskTest, ACheckpointThatCannotBeDeletedDoesNotEndTheRun) {
  const auto train = StartOn("busy=iter-00000001", "craftfleet train", Flags("run", {"--keep_checkpoints=1"}));
  const Ended ended = Finish(train.get());
  EXPECT_EQ(ended.exit_code, 0) << ended.err;
  EXPECT_THAT(ended.err, HasSubstr("cannot remove "));
  EXPECT_THAT(ended.err, HasSubstr("Device or resource busy"));
  ExpectLikeQuiet(3);
  // The next start deletes it, or says again that it cannot.
  for (const char* disk : {"busy=iter-00000001", ""}) {
    const Ended again = Finish(StartOn(disk, "craftfleet train", {"--resume", "--logdir=" + Logdir("run")}).get());
    EXPECT_EQ(again.exit_code, 0) << again.err;
  }
  EXPECT_THAT(ListFolder(Logdir("run") + "/checkpoints").value(), testing::Each(testing::StartsWith("iter-")));
}

}  // namespace
}  // namespace craftfleet
