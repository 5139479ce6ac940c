// The promise of synchronous training, on real processes over loopback: who plays, who dies and who is resumed changes
// nothing.

#include <algorithm>
#include <csignal>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/integration/process.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// Ten short iterations with deaths and truncations in them.
constexpr char kConfig[] = R"(
  steps: 10240  lanes: 16  seed: 3  fragment_steps: 64
  env { length: 90 }
  ppo { rollout_steps: 1024  minibatch_size: 128  epochs: 2 }
  checkpoint { every_iterations: 2  keep: 20 }
  eval { every_steps: 3000  episodes: 2  final_episodes: 3 }
)";
// Likewise, with recurrent states that matter.
constexpr char kRecurrentConfig[] = R"(
  agent: "lstm_cnn"  steps: 2560  lanes: 4  seed: 3  fragment_steps: 16
  env { length: 90 }
  eval { every_steps: 0  final_episodes: 0 }
  ppo { rollout_steps: 256  minibatch_size: 64  epochs: 2 }
  checkpoint { every_iterations: 2  keep: 20 }
)";
constexpr char kLastCheckpoint[] = "checkpoints/iter-00000010";
constexpr absl::Duration kPatience = absl::Seconds(120);  // sanitizer builds are slow

struct Result {
  std::string stats;
  std::string evaluations;  // during training
  std::string final_evaluation;
  std::string weights;
  std::string optimizer;
};

class FleetTest : public testing::Test {
 protected:
  // The undisturbed run in one process that every other must equal.
  static void SetUpTestSuite() {
    ASSERT_NO_FATAL_FAILURE(TrainQuietly(kConfig));
    // Three evaluations of two episodes of each kind, then three of each kind at the end.
    ASSERT_EQ(Lines(quiet_->evaluations), 2 * 3 * 2 + 1);
    ASSERT_EQ(Lines(quiet_->final_evaluation), 2 * 3 + 1);
  }
  static void TearDownTestSuite() {
    delete quiet_;
    delete shared_;
  }

  static void TrainQuietly(const std::string& config) {
    shared_ = new TempFolder;
    ASSERT_THAT(WriteFileSynced(*shared_ / "config.txt", config), IsOk());
    const auto train = Train("quiet", {});
    ASSERT_EQ(train->Wait(kPatience), 0) << train->Err();
    quiet_ = new Result(Read("quiet"));
    ASSERT_THAT(quiet_->stats, HasSubstr("\"length\": 90,"));
  }

  static std::string Logdir(const std::string& run) { return *shared_ / run; }

  static std::unique_ptr<Process> Start(const std::string& program, const std::string& log,
                                        const std::vector<std::string>& arguments) {
    auto process = Process::Start(program, arguments, *shared_ / log);
    EXPECT_THAT(process, IsOk());
    return process.ok() ? *std::move(process) : nullptr;
  }

  static std::unique_ptr<Process> Train(const std::string& run, const std::vector<std::string>& more) {
    return StartRun("craftfleet-train", run, more);
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
                                             const std::string& servers, int threads = 2) {
    return Start("craftfleet-actor", log,
                 {"--learner=" + learner, "--envservers=" + servers, absl::StrCat("--threads=", threads)});
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
    EXPECT_EQ(Read(run).final_evaluation, quiet_->final_evaluation);
  }
  static void ExpectTrainedLikeQuiet(const std::string& run) {
    const Result result = Read(run);
    EXPECT_EQ(result.stats, quiet_->stats);
    EXPECT_EQ(result.evaluations, quiet_->evaluations);
    EXPECT_TRUE(result.weights == quiet_->weights);
    EXPECT_TRUE(result.optimizer == quiet_->optimizer);
  }

  // Actors and servers come and go while the run goes on.
  static void PlayWithKills() {
    const auto learner = StartLearner("kills", "127.0.0.1:0");
    auto first_server = StartServer("kills-server1");
    const auto second_server = StartServer("kills-server2");
    const std::string learner_address = learner->WaitForAddress().value();
    const std::string first_address = first_server->WaitForAddress().value();
    const std::string servers = first_address + "," + second_server->WaitForAddress().value();
    auto first_actor = StartActor("kills-actor1", learner_address, servers);
    const auto second_actor = StartActor("kills-actor2", learner_address, servers);
    const auto third_actor = StartActor("kills-actor3", learner_address, servers);

    WaitForCheckpoint("kills", 2);
    first_actor->Kill();
    first_actor = StartActor("kills-actor1-again", learner_address, servers);
    WaitForCheckpoint("kills", 4);
    first_server->Kill();
    first_server = StartServer("kills-server1-again", first_address);
    ASSERT_FALSE(learner->Wait(absl::ZeroDuration()).has_value()) << "the run ended before the kills";

    EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
    ExpectLikeQuiet("kills");
  }
  static void OutliveTheLearner() {
    auto learner = StartLearner("learner-killed", "127.0.0.1:0");
    const auto server = StartServer("learner-killed-server");
    const std::string learner_address = learner->WaitForAddress().value();
    const auto actor = StartActor("learner-killed-actor", learner_address, server->WaitForAddress().value());
    WaitForCheckpoint("learner-killed", 4);
    learner->Kill();
    learner = StartLearner("learner-killed", learner_address, {"--resume"});
    EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
    EXPECT_EQ(actor->Wait(absl::Seconds(10)), 0) << actor->Err();
    ExpectLikeQuiet("learner-killed");
  }

  static TempFolder* shared_;
  static Result* quiet_;
};
TempFolder* FleetTest::shared_ = nullptr;
Result* FleetTest::quiet_ = nullptr;

TEST_F(FleetTest, OneActorAndOneServerEqualOneProcess) {
  const auto learner = StartLearner("one", "127.0.0.1:0", {"--threads=1"});
  const auto server = StartServer("one-server");
  const std::string learner_address = learner->WaitForAddress().value();
  const auto actor = StartActor("one-actor", learner_address, server->WaitForAddress().value(), /*threads=*/1);
  EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
  EXPECT_EQ(actor->Wait(absl::Seconds(10)), 0) << actor->Err();
  ExpectLikeQuiet("one");
  server->Signal(SIGTERM);
  EXPECT_EQ(server->Wait(absl::Seconds(10)), 0) << server->Err();
}

TEST_F(FleetTest, ThreeActorsAndTwoServersWithKillsEqualOneProcess) { PlayWithKills(); }

TEST_F(FleetTest, ARunStoppedByASignalGoesOnAsIfNeverStopped) {
  auto train = Train("stopped", {});
  WaitForCheckpoint("stopped", 2);
  train->Signal(SIGTERM);
  ASSERT_EQ(train->Wait(absl::Seconds(10)), 0) << train->Err();
  EXPECT_THAT(train->Err(), HasSubstr("go on with --resume"));
  ASSERT_FALSE(PathExists(Logdir("stopped") + "/" + kLastCheckpoint));
  train = Train("stopped", {"--resume"});
  EXPECT_EQ(train->Wait(kPatience), 0) << train->Err();
  ExpectLikeQuiet("stopped");
}

TEST_F(FleetTest, AKilledRunGoesOnAsIfNeverStopped) {
  auto train = Train("killed", {});
  WaitForCheckpoint("killed", 4);
  train->Kill();
  ASSERT_FALSE(PathExists(Logdir("killed") + "/" + kLastCheckpoint));
  train = Train("killed", {"--resume"});
  EXPECT_EQ(train->Wait(kPatience), 0) << train->Err();
  ExpectLikeQuiet("killed");
}

TEST_F(FleetTest, TheSameCommandBeginsARunAndGoesOnWithIt) {
  auto train = Train("again", {"--autoresume"});
  WaitForCheckpoint("again", 4);
  train->Kill();
  train = Train("again", {"--autoresume"});
  EXPECT_EQ(train->Wait(kPatience), 0) << train->Err();
  EXPECT_THAT(train->Err(), HasSubstr("goes on after iteration"));
  ExpectLikeQuiet("again");
}

TEST_F(FleetTest, AFleetOutlivesItsLearner) { OutliveTheLearner(); }

TEST_F(FleetTest, AFinishedRunMayBeMadeLonger) {
  auto train = Train("longer", {"--steps=4096"});
  ASSERT_EQ(train->Wait(kPatience), 0) << train->Err();
  train = Train("longer", {"--resume"});
  EXPECT_EQ(train->Wait(kPatience), 0) << train->Err();
  ExpectTrainedLikeQuiet("longer");
}

// Recurrent states travel with fragments, snapshots and checkpoints.
class RecurrentFleetTest : public FleetTest {
 protected:
  static void SetUpTestSuite() { TrainQuietly(kRecurrentConfig); }
};

TEST_F(RecurrentFleetTest, ThreeActorsAndTwoServersWithKillsEqualOneProcess) { PlayWithKills(); }

TEST_F(RecurrentFleetTest, AFleetOutlivesItsLearner) { OutliveTheLearner(); }

}  // namespace
}  // namespace craftfleet
