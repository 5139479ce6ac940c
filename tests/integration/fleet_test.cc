// The guarantee of synchronous training, with real processes over loopback: which workers play, die or resume does not
// change the result.

#include <algorithm>
#include <csignal>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_replace.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/wait_until.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// Like kConfig, with a recurrent agent.
constexpr char kRecurrentConfig[] = R"(
  agent: "lstm_cnn"  steps: 2560  lanes: 4  seed: 3  fragment_steps: 16
  network { frame_size: 36 }
  env { length: 90 }
  eval { every_steps: 0  final_episodes: 0 }
  ppo { rollout_steps: 256  minibatch_size: 64  epochs: 2 }
  checkpoint { every_iterations: 2  keep: 20 }
)";

// Likewise, with achievement distillation of a small network: three phases, some checkpoints between them.
constexpr char kDistillationConfig[] = R"(
  agent: "achievement_distillation"  steps: 2560  lanes: 4  seed: 3  fragment_steps: 16
  network { extractor: CNN  frame_size: 36 }
  env { length: 90 }
  eval { every_steps: 1000  episodes: 1  final_episodes: 0 }
  ppo { rollout_steps: 256  minibatch_size: 64  epochs: 1 }
  distillation { every_iterations: 3  epochs: 1 }
  checkpoint { every_iterations: 2  keep: 20 }
)";

class FleetTest : public FleetRunTest {
 protected:
  // An actor, the learner and a server are killed and started again during the run. Actors end with the run, and
  // servers when they are stopped.
  static void PlayWithKills() {
    auto learner = StartLearner("kills", "127.0.0.1:0");
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
    WaitForCheckpoint("kills", 4);  // between two phases of distillation
    learner->Kill();
    learner = StartLearner("kills", learner_address, {"--resume"});
    WaitForCheckpoint("kills", 6);
    first_server->Kill();
    first_server = StartServer("kills-server1-again", first_address);
    ASSERT_FALSE(learner->Wait(absl::ZeroDuration()).has_value()) << "the run ended before the kills";

    ExpectCompleteLikeQuiet("kills", learner.get());
    // An actor that has not joined again by then waits for the next learner.
    const std::vector<Process*> actors = {first_actor.get(), second_actor.get(), third_actor.get()};
    const auto has_ended = [](Process* actor) { return actor->Wait(absl::ZeroDuration()).has_value(); };
    EXPECT_TRUE(WaitUntil([&] { return std::any_of(actors.begin(), actors.end(), has_ended); }, absl::Seconds(10)));
    for (Process* const actor : actors) {
      EXPECT_EQ(actor->Wait(absl::ZeroDuration()).value_or(0), 0) << actor->Err();
      actor->Kill();
    }
    second_server->Signal(SIGTERM);
    EXPECT_EQ(second_server->Wait(absl::Seconds(10)), 0) << second_server->Err();
  }
  static void Extend() {
    auto train = Train("longer", {"--steps=4096"});
    ASSERT_EQ(train->Wait(kPatience), 0) << train->Err();
    train = Train("longer", {"--resume"});
    EXPECT_EQ(train->Wait(kPatience), 0) << train->Err();
    ExpectTrainedLikeQuiet("longer");
  }
};

TEST_F(FleetTest, ThreeActorsAndTwoServersWithKillsEqualOneProcess) { PlayWithKills(); }

// The command that starts the run also resumes it.
TEST_F(FleetTest, ARunStoppedOrKilledContinuesAsIfNeitherHadHappened) {
  auto train = Train("stopped", {"--autoresume"});
  WaitForCheckpoint("stopped", 2);
  train->Signal(SIGTERM);
  ASSERT_EQ(train->Wait(absl::Seconds(10)), 0) << train->Err();
  EXPECT_THAT(train->Err(), HasSubstr("continue with --resume"));
  train = Train("stopped", {"--resume"});
  WaitForCheckpoint("stopped", 6);
  train->Kill();
  ASSERT_FALSE(PathExists(Logdir("stopped") + "/" + kLastCheckpoint));
  train = Train("stopped", {"--autoresume"});
  ExpectCompleteLikeQuiet("stopped", train.get());
  EXPECT_THAT(train->Err(), HasSubstr("resumes after iteration"));
}

TEST_F(FleetTest, AFinishedRunCanBeExtended) { Extend(); }

// Runs with the hazards of their own: recurrent states and memories travel with fragments, snapshots and checkpoints;
// overlapped actors play during updates, with the weights from before them; values are normalised by statistics that
// change with each update; checkpoints between two phases of distillation hold the rollouts so far.
class EachKindOfFleetTest : public FleetTest, public testing::WithParamInterface<const char*> {
 protected:
  void SetUp() override {
    const std::string kind = GetParam();
    if (kind == "recurrent") TrainQuietly(kRecurrentConfig);
    if (kind == "overlapped") TrainQuietly(absl::StrCat(kConfig, "overlap: 1"));
    if (kind == "overlapped_norm") {
      TrainQuietly(absl::StrReplaceAll(kRecurrentConfig, {{"ppo {", "overlap: 1  ppo { value_norm_decay: 0.9 "}}));
    }
    if (kind == "distillation") TrainQuietly(kDistillationConfig);
  }
};

TEST_P(EachKindOfFleetTest, ThreeActorsAndTwoServersWithKillsEqualOneProcess) { PlayWithKills(); }

INSTANTIATE_TEST_SUITE_P(Kinds, EachKindOfFleetTest,
                         testing::Values("recurrent", "overlapped", "overlapped_norm", "distillation"),
                         [](const auto& info) { return std::string(info.param); });

class OverlappedFleetTest : public FleetTest {
 protected:
  void SetUp() override { TrainQuietly(absl::StrCat(kConfig, "overlap: 1")); }
};

TEST_F(OverlappedFleetTest, AFinishedRunCanBeExtended) { Extend(); }

// Frames of the usual size, and episodes that end in the night, whose pictures have noise. One epoch, to save time.
class FrameFormatsFleetTest : public FleetTest {
 protected:
  void SetUp() override {
    const std::string config = absl::StrReplaceAll(
        kConfig, {{"frame_size: 36", "frame_size: 64"}, {"length: 90", "length: 230"}, {"epochs: 2", "epochs: 1"}});
    TrainQuietly(config, 230);
  }
};

TEST_F(FrameFormatsFleetTest, ActorsWithDifferentFormatsAndKillsEqualOneProcess) {
  Fleet fleet = StartFleet("formats", /*registers=*/false, {"--frames=scene"}, /*threads=*/1);
  const auto second_server = StartServer("formats-server2");
  const std::string servers = fleet.server_address + "," + second_server->WaitForAddress().value();
  const auto start = [&](const std::string& log, const std::string& format) {
    return StartActor(log, fleet.address, servers, /*threads=*/1, {"--frames=" + format});
  };
  auto second_actor = start("formats-actor2", "raw");
  const auto third_actor = start("formats-actor3", "scene");
  WaitForCheckpoint("formats", 2);
  fleet.actor = start("formats-actor1-again", "raw");  // in place of the first, which is killed
  WaitForCheckpoint("formats", 4);
  second_actor = start("formats-actor2-again", "scene");
  ExpectCompleteLikeQuiet("formats", fleet.learner.get());
  EXPECT_THAT(fleet.learner->Err(), testing::Not(HasSubstr("differ")));
}

// Lanes play on without waiting for each other. The result depends on the order of arrival. Values are normalised by
// statistics that change with each update; each fragment's are those of its weights.
class AsynchronousFleetTest : public FleetTest {
 protected:
  void SetUp() override {
    Configure(absl::StrReplaceAll(kRecurrentConfig, {{"ppo {", "max_staleness: 2  ppo { value_norm_decay: 0.9 "},
                                                     {"every_steps: 0  final_episodes: 0",
                                                      "every_steps: 1000  episodes: 1  final_episodes: 1"}}));
  }
  static void ExpectAWholeRun() {
    EXPECT_GT(Lines(Read("async").stats), 0);
    EXPECT_NE(Read("async").weights, "none");
  }
};

// Of three actors one is stopped for a while and one is killed; the learner is killed too.
TEST_F(AsynchronousFleetTest, AFleetOutlivesFaults) {
  Fleet fleet = StartFleet("async", /*registers=*/false, {}, /*threads=*/1);
  const auto stopped = StartActor("async-stopped", fleet.address, fleet.server_address, /*threads=*/1);
  auto killed = StartActor("async-killed", fleet.address, fleet.server_address, /*threads=*/1);
  WaitForCheckpoint("async", 2);
  stopped->Signal(SIGSTOP);
  WaitForCheckpoint("async", 4);
  stopped->Signal(SIGCONT);
  killed->Kill();
  WaitForCheckpoint("async", 6);
  fleet.RestartLearner("async");
  EXPECT_EQ(fleet.learner->Wait(kPatience), 0) << fleet.learner->Err();
  EXPECT_THAT(fleet.learner->Err(), HasSubstr("resumes after iteration"));
  EXPECT_EQ(fleet.actor->Wait(absl::Seconds(10)), 0) << fleet.actor->Err();
  ExpectAWholeRun();
}

TEST_F(AsynchronousFleetTest, ARunInOneProcessCanBeKilledAndResumed) {
  auto train = Train("async", {});
  WaitForCheckpoint("async", 4);
  train->Kill();
  train = Train("async", {"--resume"});
  ASSERT_EQ(train->Wait(kPatience), 0) << train->Err();
  ExpectAWholeRun();
}

}  // namespace
}  // namespace craftfleet
