// Run folders that are damaged, of another configuration, or on a full disk.

#include <sys/resource.h>

#include <csignal>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_replace.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/test_paths.h"
#include "tests/fakes/wait_until.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class BadRunFolderTest : public SmallRunTest {
 protected:
  // Resumes the run for one iteration more; expects that it is refused and returns the error.
  std::string RefusedToResume(const std::vector<std::string>& more = {"--steps=256"}) {
    const Ended ended = Resume(more);
    EXPECT_EQ(ended.exit_code, 1);
    return ended.err;
  }
  Ended Resume(const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"--resume", "--logdir=" + Logdir("run")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Run("craftfleet train", arguments);
  }
};

TEST_F(BadRunFolderTest, ResumeRefusesAnotherConfiguration) {
  CopyTrained("run");
  const auto refused = [this](const std::string& flag, const std::string& error) {
    EXPECT_THAT(RefusedToResume({flag}), AllOf(HasSubstr(error), HasSubstr("may change")));
  };
  refused("--lanes=2", "lanes: 4 -> 2");
  refused("--lanes=8", "lanes * fragment_steps (128)");
  refused("--seed=4", "seed: 3 -> 4");
  refused("--env=crafter:inventory=off", "\"crafter\" -> \"crafter:inventory=off\"");
}

TEST_F(BadRunFolderTest, ADamagedConfigurationIsRefusedAndNothingIsWritten) {
  CopyTrained("run");
  const std::string path = Logdir("run") + "/config.txt";
  const std::string sound = ReadFile(path).value();
  const auto refused = [&](const std::string& error) {
    const std::string stats = Text("run", "stats.jsonl");
    EXPECT_THAT(RefusedToResume(), AllOf(HasSubstr(path), HasSubstr(error)));
    EXPECT_EQ(Text("run", "stats.jsonl"), stats);
  };
  for (const std::string& damaged : {std::string(), absl::StrReplaceAll(sound, {{"seed: 3", "seed: 4"}})}) {
    ASSERT_THAT(WriteFileSynced(path, damaged), IsOk());
    refused("undo these changes in it: modified: ");
  }
  ASSERT_THAT(RemoveAll(path), IsOk());
  refused("put back the configuration that it was started with");
  ASSERT_THAT(WriteFileSynced(path, sound), IsOk());
  EXPECT_EQ(Resume({}).exit_code, 0);
}

// A fleet whose learner's disk fills up. A file size limit simulates the full disk, so SIGXFSZ must be ignored.
class FullDiskTest : public BadRunFolderTest {
 protected:
  void StartLearner(const std::vector<std::string>& more) {
    std::vector<std::string> words = {"-c", "trap '' XFSZ; exec \"$0\" \"$@\"", BuiltProgram("craftfleet-learner")};
    const std::vector<std::string> flags = Flags("run", more);
    words.insert(words.end(), flags.begin(), flags.end());
    learner_ = Start("/bin/bash", words);
    ASSERT_THAT(learner_->WaitForAddress(), IsOk());
    // The first checkpoint, before any game, must still fit.
    ASSERT_TRUE(WaitUntil([this] { return PathExists(Checkpoint("run", 0)); }, kPatience));
  }
  void StartWorkers() {
    server_ = Start("craftfleet-envserver", {"--listen=127.0.0.1:0"});
    actor_ = Start("craftfleet-actor", {"--learner=" + learner_->WaitForAddress().value(),
                                        "--envservers=" + server_->WaitForAddress().value()});
  }
  // Limits the files of the learner to `bytes` from now on.
  void LimitFiles(rlim_t bytes) {
    const rlimit limit = {bytes, RLIM_INFINITY};
    ASSERT_EQ(prlimit(learner_->pid(), RLIMIT_FSIZE, &limit, nullptr), 0);
  }

  std::unique_ptr<Process> learner_;
  std::unique_ptr<Process> server_;
  std::unique_ptr<Process> actor_;
};

TEST_F(FullDiskTest, TrainingContinuesAndCatchesUpOnceThereIsSpace) {
  ASSERT_THAT(WriteFileSynced(config(), absl::StrReplaceAll(kConfig, {{"steps: 192", "steps: 1280"}})), IsOk());
  Train("quiet");
  StartLearner({"--listen=127.0.0.1:0"});
  LimitFiles(4096);  // two iterations of TensorBoard's events, and the log on standard error
  StartWorkers();
  EXPECT_TRUE(learner_->WaitForText("/run/events.out.tfevents.craftfleet: File too large", kPatience))
      << learner_->Err();
  EXPECT_TRUE(learner_->WaitForText("error: checkpoint of iteration 1: ", kPatience)) << learner_->Err();
  LimitFiles(RLIM_INFINITY);
  const Ended ended = Finish(learner_.get());
  EXPECT_EQ(ended.exit_code, 0) << ended.err;
  EXPECT_THAT(ended.err, HasSubstr("error: checkpoint of iteration 1: "));
  EXPECT_THAT(ended.err, HasSubstr("training continues and tries again"));
  EXPECT_FALSE(PathExists(Checkpoint("run", 1)));
  EXPECT_EQ(Text("run", "stats.jsonl"), Text("quiet", "stats.jsonl"));
  const std::string last = "checkpoints/iter-00000020/weights.safetensors";
  EXPECT_NE(Text("run", last), "none");
  EXPECT_TRUE(Text("run", last) == Text("quiet", last));
}

TEST_F(FullDiskTest, TheEndOfTheRunWaitsForSpaceAndAStopReportsTheUnwrittenFile) {
  StartLearner({"--listen=127.0.0.1:0"});
  LimitFiles(1 << 20);  // enough for the logs
  StartWorkers();
  EXPECT_TRUE(learner_->WaitForText("the last checkpoint will be written once there is space", kPatience))
      << learner_->Err();
  learner_->Signal(SIGTERM);
  const Ended ended = Finish(learner_.get());
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("error: checkpoint of iteration 1: "));
  EXPECT_THAT(ended.err, HasSubstr("error: checkpoint of iteration 2: "));
  EXPECT_THAT(ended.err, HasSubstr("craftfleet-learner: "));
  EXPECT_THAT(ended.err, HasSubstr("weights.safetensors: File too large"));
  EXPECT_THAT(Text("run", "stats.jsonl"), HasSubstr("\"length\": 20"));
  // Earlier checkpoints are intact, and the run can resume from them.
  const Ended resumed = Resume({});
  EXPECT_EQ(resumed.exit_code, 0) << resumed.err;
  EXPECT_TRUE(PathExists(Checkpoint("run", 3)));
}

TEST_F(FullDiskTest, ARunThatCannotBeginReportsWhy) {
  const Ended ended =
      Run("/bin/bash", {"-c", "trap '' XFSZ; ulimit -f 100; exec \"$0\" \"$@\"", BuiltProgram("craftfleet"), "train",
                        "--config=" + config(), "--logdir=" + Logdir("run")});
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr(Logdir("run")));
  EXPECT_THAT(ended.err, HasSubstr("File too large"));
  Train("run");
}

}  // namespace
}  // namespace craftfleet
