// A learner, actors and environment servers as processes over loopback. Their results must equal those of a run in one
// process.

#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <absl/time/time.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/integration/process.h"

namespace craftfleet {

// Ten short iterations with deaths and truncations. Frames of 36 pixels take a third of the time of the usual 64.
inline constexpr char kConfig[] = R"(
  network { frame_size: 36 }
  steps: 10240  lanes: 16  seed: 3  fragment_steps: 64
  env { length: 90 }
  ppo { rollout_steps: 1024  minibatch_size: 128  epochs: 2 }
  checkpoint { every_iterations: 2  keep: 20 }
  eval { every_steps: 3000  episodes: 2  final_episodes: 3 }
)";
inline constexpr char kLastCheckpoint[] = "checkpoints/iter-00000010";

// Ten shorter iterations.
inline constexpr char kTenIterations[] = R"(
  network { frame_size: 36 }
  steps: 5120  lanes: 8  seed: 3  fragment_steps: 64
  env { length: 90 }
  ppo { rollout_steps: 512  minibatch_size: 128  epochs: 2 }
  checkpoint { every_iterations: 2  keep: 20 }
  eval { every_steps: 1500  episodes: 2  final_episodes: 2 }
)";

struct Result {
  std::string stats;
  std::string evaluations;  // during training
  std::string final_evaluation;
  std::string weights;
  std::string optimizer;
};

class FleetRunTest : public testing::Test {
 protected:
  // Not in SetUpTestSuite, since tests count as skipped if that fails.
  void SetUp() override {
    ASSERT_NO_FATAL_FAILURE(TrainQuietly(kConfig));
    // Three evaluations of two episodes of each kind, then three of each kind at the end.
    ASSERT_EQ(Lines(quiet_->evaluations), 2 * 3 * 2 + 1);
    ASSERT_EQ(Lines(quiet_->final_evaluation), 2 * 3 + 1);
  }
  static void TearDownTestSuite() { shared_.reset(); }

  // Gives the test a folder of its own, for runs of `config`.
  static void Configure(const std::string& config) {
    shared_ = std::make_unique<TempFolder>();
    ASSERT_THAT(WriteFileSynced(*shared_ / "config.txt", config), IsOk());
  }
  // Likewise, and makes the undisturbed run in one process that every other run of `config` must equal, unless an
  // earlier test has made it. `length`: steps of a truncated episode.
  static void TrainQuietly(const std::string& config, int length = 90) {
    ASSERT_NO_FATAL_FAILURE(Configure(config));
    quiet_ = &quiet_results_[config];
    if (!quiet_->stats.empty()) return;
    const auto train = Train("quiet", {});
    ASSERT_EQ(train->Wait(kPatience), 0) << train->Err();
    *quiet_ = Read("quiet");
    ASSERT_THAT(quiet_->stats, testing::HasSubstr(absl::StrCat("\"length\": ", length, ",")));
  }

  static std::string Logdir(const std::string& run) { return *shared_ / run; }

  static std::unique_ptr<Process> Start(const std::string& program, const std::string& log,
                                        const std::vector<std::string>& arguments) {
    auto process = Process::Start(program, arguments, *shared_ / log);
    EXPECT_THAT(process, IsOk());
    return process.ok() ? *std::move(process) : nullptr;
  }

  static std::unique_ptr<Process> Train(const std::string& run, const std::vector<std::string>& more) {
    return StartRun("craftfleet train", run, more);
  }
  static std::unique_ptr<Process> StartLearner(const std::string& run, const std::string& listen,
                                               const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments = {"--listen=" + listen};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return StartRun("craftfleet-learner", run, arguments);
  }
  static std::unique_ptr<Process> StartRun(const std::string& program, const std::string& run,
                                           const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"--config=" + *shared_ / "config.txt", "--logdir=" + Logdir(run)};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Start(program, run + "-learner", arguments);
  }
  static std::unique_ptr<Process> StartServer(const std::string& log, const std::string& listen = "127.0.0.1:0") {
    return Start("craftfleet-envserver", log, {"--listen=" + listen});
  }
  static std::unique_ptr<Process> StartActor(const std::string& log, const std::string& learner,
                                             const std::string& servers, int threads = 2,
                                             const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments = {"--learner=" + learner, "--envservers=" + servers,
                                          absl::StrCat("--threads=", threads)};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Start("craftfleet-actor", log, arguments);
  }

  // A learner, an environment server and an actor that plays on it.
  struct Fleet {
    std::unique_ptr<Process> learner, server, actor;
    std::string address;         // the learner's
    std::string server_address;  // the server's

    // Kills the learner; another resumes its run.
    void RestartLearner(const std::string& run) {
      learner->Kill();
      learner = StartLearner(run, address, {"--resume"});
    }
  };
  // With `registers` the server registers with the learner, which the actor asks for servers.
  static Fleet StartFleet(const std::string& run, bool registers = false, const std::vector<std::string>& actor = {},
                          int threads = 2) {
    Fleet fleet;
    fleet.learner = StartLearner(run, "127.0.0.1:0");
    fleet.address = fleet.learner->WaitForAddress("listening on ", kPatience).value();
    fleet.server = registers ? StartRegisteredServer(run + "-server", fleet.address) : StartServer(run + "-server");
    fleet.server_address = fleet.server->WaitForAddress("listening on ", kPatience).value();
    fleet.actor =
        StartActor(run + "-actor", fleet.address, registers ? "learner" : fleet.server_address, threads, actor);
    return fleet;
  }
  static std::unique_ptr<Process> StartRegisteredServer(const std::string& log, const std::string& learner) {
    return Start("craftfleet-envserver", log, {"--listen=127.0.0.1:0", "--learner=" + learner});
  }
  static void ExpectCompleteLikeQuiet(const std::string& run, Process* learner) {
    EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
    ExpectLikeQuiet(run);
  }
  static void ExpectComplete(const std::string& run, const Fleet& fleet) {
    ExpectCompleteLikeQuiet(run, fleet.learner.get());
    EXPECT_EQ(fleet.actor->Wait(absl::Seconds(10)), 0) << fleet.actor->Err();
  }

  // Waits until `run` has written the checkpoint of `iteration`.
  static void WaitForCheckpoint(const std::string& run, int iteration) {
    const std::string path = absl::StrCat(Logdir(run), "/checkpoints/iter-0000000", iteration);
    const absl::Time deadline = absl::Now() + kPatience;
    while (!PathExists(path) && absl::Now() < deadline) absl::SleepFor(absl::Milliseconds(5));
    ASSERT_TRUE(PathExists(path)) << path;
  }

  static int64_t Lines(const std::string& text) { return std::count(text.begin(), text.end(), '\n'); }
  static Result Read(const std::string& run) {
    const std::string checkpoint = Logdir(run) + "/" + kLastCheckpoint;
    const auto log = [&](const std::string& name) { return ReadFile(Logdir(run) + "/" + name).value_or("none"); };
    return {log("stats.jsonl"), log("eval_argmax.jsonl") + "\n" + log("eval_sampled.jsonl"),
            log("final_argmax.jsonl") + "\n" + log("final_sampled.jsonl"),
            ReadFile(checkpoint + "/weights.safetensors").value_or("none"),
            ReadFile(checkpoint + "/optimizer.safetensors").value_or("none")};
  }
  static void ExpectLikeQuiet(const std::string& run) {
    ExpectTrainedLikeQuiet(run);
    ExpectSame(Read(run).final_evaluation, quiet_->final_evaluation, "final evaluation");
  }
  static void ExpectTrainedLikeQuiet(const std::string& run) {
    const Result result = Read(run);
    ExpectSame(result.stats, quiet_->stats, "stats.jsonl");
    ExpectSame(result.evaluations, quiet_->evaluations, "evaluations");
    ExpectSame(result.weights, quiet_->weights, "weights");
    ExpectSame(result.optimizer, quiet_->optimizer, "optimizer");
  }
  // Does not print the whole texts.
  static void ExpectSame(const std::string& actual, const std::string& wanted, const std::string& what) {
    EXPECT_TRUE(actual == wanted) << what << ": " << actual.size() << " bytes, want " << wanted.size()
                                  << ", first different one at "
                                  << std::mismatch(actual.begin(), actual.end(), wanted.begin(), wanted.end()).first -
                                         actual.begin();
  }

  static inline std::unique_ptr<TempFolder> shared_;           // of the test's processes
  static inline std::map<std::string, Result> quiet_results_;  // by configuration
  static inline Result* quiet_ = nullptr;                      // that of the test's
};

}  // namespace craftfleet
