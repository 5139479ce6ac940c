// The guarantee of synchronous training, with real processes over loopback: which workers play, die or resume does not
// change the result.

#include <csignal>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_replace.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "learner/run/checkpoint_store.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// Like kConfig, with a recurrent agent.
constexpr char kRecurrentConfig[] = R"(
  agent: "lstm_cnn"  steps: 2560  lanes: 4  seed: 3  fragment_steps: 16
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
  // Actors and servers come and go during the run.
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
  static void Extend() {
    auto train = Train("longer", {"--steps=4096"});
    ASSERT_EQ(train->Wait(kPatience), 0) << train->Err();
    train = Train("longer", {"--resume"});
    EXPECT_EQ(train->Wait(kPatience), 0) << train->Err();
    ExpectTrainedLikeQuiet("longer");
  }
};

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

TEST_F(FleetTest, ARunStoppedByASignalContinuesAsIfNeverStopped) {
  auto train = Train("stopped", {});
  WaitForCheckpoint("stopped", 2);
  train->Signal(SIGTERM);
  ASSERT_EQ(train->Wait(absl::Seconds(10)), 0) << train->Err();
  EXPECT_THAT(train->Err(), HasSubstr("continue with --resume"));
  ASSERT_FALSE(PathExists(Logdir("stopped") + "/" + kLastCheckpoint));
  train = Train("stopped", {"--resume"});
  EXPECT_EQ(train->Wait(kPatience), 0) << train->Err();
  ExpectLikeQuiet("stopped");
}

TEST_F(FleetTest, AKilledRunContinuesAsIfNeverStopped) {
  auto train = Train("killed", {});
  WaitForCheckpoint("killed", 4);
  train->Kill();
  ASSERT_FALSE(PathExists(Logdir("killed") + "/" + kLastCheckpoint));
  train = Train("killed", {"--resume"});
  EXPECT_EQ(train->Wait(kPatience), 0) << train->Err();
  ExpectLikeQuiet("killed");
}

TEST_F(FleetTest, TheSameCommandStartsAndResumesARun) {
  auto train = Train("again", {"--autoresume"});
  WaitForCheckpoint("again", 4);
  train->Kill();
  train = Train("again", {"--autoresume"});
  EXPECT_EQ(train->Wait(kPatience), 0) << train->Err();
  EXPECT_THAT(train->Err(), HasSubstr("resumes after iteration"));
  ExpectLikeQuiet("again");
}

TEST_F(FleetTest, AFleetOutlivesItsLearner) { OutliveTheLearner(); }

TEST_F(FleetTest, AFinishedRunCanBeExtended) { Extend(); }

// Recurrent states travel with fragments, snapshots and checkpoints.
class RecurrentFleetTest : public FleetTest {
 protected:
  void SetUp() override { TrainQuietly(kRecurrentConfig); }
};

TEST_F(RecurrentFleetTest, ThreeActorsAndTwoServersWithKillsEqualOneProcess) { PlayWithKills(); }

TEST_F(RecurrentFleetTest, AFleetOutlivesItsLearner) { OutliveTheLearner(); }

// Actors play during updates, with the weights from before them.
class OverlappedFleetTest : public FleetTest {
 protected:
  void SetUp() override { TrainQuietly(absl::StrCat(kConfig, "overlap: 1")); }
};

TEST_F(OverlappedFleetTest, ThreeActorsAndTwoServersWithKillsEqualOneProcess) { PlayWithKills(); }

TEST_F(OverlappedFleetTest, AFleetOutlivesItsLearner) { OutliveTheLearner(); }

TEST_F(OverlappedFleetTest, AFinishedRunCanBeExtended) { Extend(); }

// Episodes that end in the night, whose pictures have noise.
class FrameFormatsFleetTest : public FleetTest {
 protected:
  void SetUp() override { TrainQuietly(absl::StrReplaceAll(kConfig, {{"length: 90", "length: 230"}}), 230); }
};

TEST_F(FrameFormatsFleetTest, EveryFormatEqualsOneProcess) {
  for (const std::string format : {"raw", "scene"}) {
    const auto learner = StartLearner(format, "127.0.0.1:0");
    const auto server = StartServer(format + "-server");
    const std::string learner_address = learner->WaitForAddress().value();
    const auto actor = StartActor(format + "-actor", learner_address, server->WaitForAddress().value(), /*threads=*/2,
                                  {"--frames=" + format});
    EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
    EXPECT_EQ(actor->Wait(absl::Seconds(10)), 0) << actor->Err();
    ExpectLikeQuiet(format);
  }
}

TEST_F(FrameFormatsFleetTest, ActorsWithDifferentFormatsAndKillsEqualOneProcess) {
  const auto learner = StartLearner("formats", "127.0.0.1:0");
  const auto first_server = StartServer("formats-server1");
  const auto second_server = StartServer("formats-server2");
  const std::string learner_address = learner->WaitForAddress().value();
  const std::string servers = first_server->WaitForAddress().value() + "," + second_server->WaitForAddress().value();
  const auto start = [&](const std::string& log, const std::string& format) {
    return StartActor(log, learner_address, servers, /*threads=*/1, {"--frames=" + format});
  };
  auto first_actor = start("formats-actor1", "scene");
  auto second_actor = start("formats-actor2", "raw");
  const auto third_actor = start("formats-actor3", "scene");
  WaitForCheckpoint("formats", 2);
  first_actor->Kill();
  first_actor = start("formats-actor1-again", "raw");
  WaitForCheckpoint("formats", 4);
  second_actor->Kill();
  second_actor = start("formats-actor2-again", "scene");
  EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
  EXPECT_THAT(learner->Err(), testing::Not(HasSubstr("differ")));
  ExpectLikeQuiet("formats");
}

TEST_F(FleetTest, WithoutStalenessARunIsSynchronous) {
  const auto train = Train("no-staleness", {"--max_staleness=0"});
  ASSERT_EQ(train->Wait(kPatience), 0) << train->Err();
  ExpectLikeQuiet("no-staleness");
}

// Lanes play on without waiting for each other. The result depends on the order of arrival.
class AsynchronousFleetTest : public FleetTest {
 protected:
  void SetUp() override {
    shared_ = std::make_unique<TempFolder>();
    ASSERT_THAT(
        WriteFileSynced(*shared_ / "config.txt", absl::StrReplaceAll(Config(), {{"ppo {", "max_staleness: 2  ppo {"}})),
        IsOk());
  }
  virtual std::string Config() { return kConfig; }

  // Trains with three actors, of which one is stopped for a while and one is killed, and a learner that is killed.
  static void OutliveFaults() {
    auto learner = StartLearner("async", "127.0.0.1:0");
    const auto server = StartServer("async-server");
    const std::string learner_address = learner->WaitForAddress().value();
    const std::string server_address = server->WaitForAddress().value();
    const auto stopped = StartActor("async-stopped", learner_address, server_address, /*threads=*/1);
    auto killed = StartActor("async-killed", learner_address, server_address, /*threads=*/1);
    const auto steady = StartActor("async-steady", learner_address, server_address, /*threads=*/1);
    WaitForCheckpoint("async", 2);
    stopped->Signal(SIGSTOP);
    WaitForCheckpoint("async", 4);
    stopped->Signal(SIGCONT);
    killed->Kill();
    WaitForCheckpoint("async", 6);
    learner->Kill();
    learner = StartLearner("async", learner_address, {"--resume"});
    EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
    EXPECT_THAT(learner->Err(), HasSubstr("resumes after iteration"));
    EXPECT_EQ(steady->Wait(absl::Seconds(10)), 0) << steady->Err();
    ExpectComplete();
  }
  static void ExpectComplete() {
    EXPECT_GT(Lines(Read("async").stats), 0);
    EXPECT_FALSE(Read("async").weights.empty());
  }
};

TEST_F(AsynchronousFleetTest, AFleetOutlivesFaults) { OutliveFaults(); }

TEST_F(AsynchronousFleetTest, ARunInOneProcessCanBeKilledAndResumed) {
  auto train = Train("async", {});
  WaitForCheckpoint("async", 4);
  train->Kill();
  train = Train("async", {"--resume"});
  ASSERT_EQ(train->Wait(kPatience), 0) << train->Err();
  ExpectComplete();
}

// Values are normalised by statistics that change with each update; each fragment's are those of its weights.
class AsynchronousNormFleetTest : public AsynchronousFleetTest {
 protected:
  std::string Config() override {
    return absl::StrReplaceAll(kRecurrentConfig, {{"ppo {", "ppo { value_norm_decay: 0.9 "}});
  }
};

TEST_F(AsynchronousNormFleetTest, AFleetOutlivesFaults) { OutliveFaults(); }

// With values that are normalised, by statistics that change with each update, and a recurrent state.
class OverlappedNormFleetTest : public FleetTest {
 protected:
  void SetUp() override {
    TrainQuietly(absl::StrReplaceAll(kRecurrentConfig, {{"ppo {", "overlap: 1  ppo { value_norm_decay: 0.9 "}}));
  }
};

TEST_F(OverlappedNormFleetTest, ThreeActorsAndTwoServersWithKillsEqualOneProcess) { PlayWithKills(); }

TEST_F(OverlappedNormFleetTest, AFleetOutlivesItsLearner) { OutliveTheLearner(); }

// Memories travel as recurrent states do, and checkpoints between two phases of distillation hold the rollouts so far.
class DistillationFleetTest : public FleetTest {
 protected:
  void SetUp() override { TrainQuietly(kDistillationConfig); }
};

TEST_F(DistillationFleetTest, ThreeActorsAndTwoServersWithKillsEqualOneProcess) { PlayWithKills(); }

TEST_F(DistillationFleetTest, AFleetOutlivesItsLearner) { OutliveTheLearner(); }

// The learner stores the fragments of the current iteration on disk.
class JournalFleetTest : public FleetTest {
 protected:
  void SetUp() override { TrainQuietly(JournalConfig()); }
  static std::string JournalConfig() {
    return absl::StrReplaceAll(kRecurrentConfig,
                               {{"every_iterations: 2", "every_iterations: 1  keep_fragments: true"}});
  }
  static uintmax_t KeptBytes(const std::string& run) {
    return std::filesystem::file_size(Logdir(run) + "/fragments.journal");
  }
  // Stops `actor` within an iteration.
  static void StopWithin(const std::string& run, Process* actor) {
    const absl::Time deadline = absl::Now() + kPatience;
    while (absl::Now() < deadline) {
      absl::SleepFor(absl::Milliseconds(1));
      if (KeptBytes(run) == 0) continue;
      actor->Signal(SIGSTOP);
      // An update that has begun ends, and its fragments leave the journal.
      uintmax_t kept = 0;
      do {
        kept = KeptBytes(run);
        absl::SleepFor(absl::Milliseconds(500));
      } while (KeptBytes(run) != kept);
      if (kept > 0) return;
      actor->Signal(SIGCONT);
    }
    FAIL() << "no iteration was caught halfway";
  }
  // Kills the learner within an iteration.
  static void KillWithin();
};

void JournalFleetTest::KillWithin() {
  auto learner = StartLearner("kept", "127.0.0.1:0");
  const auto server = StartServer("kept-server");
  const std::string learner_address = learner->WaitForAddress().value();
  const auto actor = StartActor("kept-actor", learner_address, server->WaitForAddress().value());
  WaitForCheckpoint("kept", 3);
  StopWithin("kept", actor.get());
  learner->Kill();
  learner = StartLearner("kept", learner_address, {"--resume"});
  actor->Signal(SIGCONT);
  EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
  EXPECT_THAT(learner->Err(),
              testing::ContainsRegex("[0-9]+ fragments of iteration [0-9]+ were restored from the journal"));
  ExpectLikeQuiet("kept");
  EXPECT_EQ(KeptBytes("kept"), 0) << "they are not needed after the run";
}

TEST_F(JournalFleetTest, FragmentsAcceptedByAKilledLearnerAreNotPlayedAgain) { KillWithin(); }

class OverlappedJournalFleetTest : public JournalFleetTest {
 protected:
  void SetUp() override { TrainQuietly(absl::StrCat(JournalConfig(), "overlap: 1")); }
};

TEST_F(OverlappedJournalFleetTest, FragmentsAcceptedByAKilledLearnerAreNotPlayedAgain) { KillWithin(); }

}  // namespace
}  // namespace craftfleet
