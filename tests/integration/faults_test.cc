// Faults in a fleet cost time but do not change the result: workers that are suspended, stopped, out of memory or cut
// off, and a full disk. Killed workers are in fleet_test.cc; all faults combined are in tests/chaos.

#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <cerrno>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include <absl/cleanup/cleanup.h>
#include <absl/strings/match.h>
#include <absl/strings/numbers.h>
#include <absl/strings/str_split.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "tests/fakes/tcp_forwarder.h"
#include "tests/fakes/wait_until.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::AnyOf;
using testing::HasSubstr;
using testing::Not;

class FaultsTest : public FleetRunTest {
 protected:
  void SetUp() override { TrainQuietly(kTenIterations); }

  // The status of a process as JSON; null if it does not answer.
  static nlohmann::json StatusOf(const std::string& address) {
    const auto status = Start("craftfleet status", "status", {"--address=" + address, "--json"});
    if (status->Wait(kPatience) != 0) return nullptr;
    return nlohmann::json::parse(status->Out(), nullptr, /*allow_exceptions=*/false);
  }
  static double Metric(const std::string& address, const std::string& name) {
    const nlohmann::json status = StatusOf(address);
    if (!status.is_object()) return -1;
    for (const nlohmann::json& metric : status["metrics"]) {
      if (metric["name"] == name) return metric["value"];
    }
    ADD_FAILURE() << "no metric " << name << " in " << status.dump();
    return -1;
  }
  static std::unique_ptr<Process> StartServerFor(const std::string& log, const std::string& learner) {
    return Start("craftfleet-envserver", log, {"--listen=127.0.0.1:0", "--learner=" + learner});
  }
  // The number of permits that the learner's actors hold.
  static int OutstandingPermits(const std::string& learner) {
    int permits = 0;
    const nlohmann::json status = StatusOf(learner);
    for (const nlohmann::json& peer : status["peers"]) {  // "4 permits, 12 fragments accepted"
      int of_one = 0;
      const std::vector<std::string> words = absl::StrSplit(peer["state"].get<std::string>(), ' ');
      if (peer["role"] == "actor" && absl::SimpleAtoi(words[0], &of_one)) permits += of_one;
    }
    return permits;
  }
  // Suspends the only actor of `learner` while it holds permits.
  static void PauseWithPermits(Process* actor, const std::string& learner) {
    ASSERT_TRUE(WaitUntil([&] {
      actor->Signal(SIGSTOP);
      absl::SleepFor(absl::Milliseconds(50));  // messages under way arrive
      if (OutstandingPermits(learner) > 0) return true;
      actor->Signal(SIGCONT);
      absl::SleepFor(absl::Milliseconds(20));
      return false;
    }));
  }
  static void ExpectCompleteLikeQuiet(const std::string& run, Process* learner) {
    EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
    ExpectLikeQuiet(run);
  }
};

TEST_F(FaultsTest, AnActorPausedFor4SecondsKeepsItsLanesAndOnePausedFor15LosesThem) {
  const auto learner = StartLearner("paused-actor", "127.0.0.1:0");
  const auto server = StartServer("paused-actor-server");
  const std::string address = learner->WaitForAddress().value();
  const auto actor = StartActor("paused-actor-actor", address, server->WaitForAddress().value());
  WaitForCheckpoint("paused-actor", 2);
  ASSERT_NO_FATAL_FAILURE(PauseWithPermits(actor.get(), address));
  absl::SleepFor(absl::Seconds(4));
  actor->Signal(SIGCONT);
  WaitForCheckpoint("paused-actor", 4);
  EXPECT_EQ(Metric(address, "permits_lapsed"), 0);
  EXPECT_EQ(Metric(address, "fragments_expired"), 0);

  ASSERT_NO_FATAL_FAILURE(PauseWithPermits(actor.get(), address));
  absl::SleepFor(absl::Seconds(15));
  actor->Signal(SIGCONT);
  EXPECT_TRUE(actor->WaitForText("join again", kPatience)) << "it learns that it lost them: " << actor->Err();
  EXPECT_GT(Metric(address, "permits_lapsed"), 0);
  ExpectCompleteLikeQuiet("paused-actor", learner.get());
}

TEST_F(FaultsTest, AServerPausedFor4SecondsKeepsItsGamesAndOnePausedFor15LosesThem) {
  const auto learner = StartLearner("paused-server", "127.0.0.1:0");
  const std::string address = learner->WaitForAddress().value();
  const auto server = StartServerFor("paused-server-server", address);
  const auto actor = StartActor("paused-server-actor", address, "learner");
  WaitForCheckpoint("paused-server", 2);
  server->Signal(SIGSTOP);
  absl::SleepFor(absl::Seconds(4));
  server->Signal(SIGCONT);
  WaitForCheckpoint("paused-server", 4);
  EXPECT_THAT(actor->Err(), Not(HasSubstr("fragments returned")));
  EXPECT_THAT(server->Err(), Not(HasSubstr("trying again")));

  server->Signal(SIGSTOP);
  EXPECT_TRUE(actor->WaitForText("fragments returned", absl::Seconds(12))) << actor->Err();
  absl::SleepFor(absl::Seconds(5));
  server->Signal(SIGCONT);
  ExpectCompleteLikeQuiet("paused-server", learner.get());
}

// Batch systems and laptops suspend processes.
TEST_F(FaultsTest, ARunInOneProcessThatIsPausedGoesOn) {
  const auto train = Train("paused-run", {});
  WaitForCheckpoint("paused-run", 2);
  for (int pause = 0; pause < 3; ++pause) {
    train->Signal(SIGSTOP);
    absl::SleepFor(absl::Seconds(6));  // longer than any answer may take
    train->Signal(SIGCONT);
    absl::SleepFor(absl::Milliseconds(100));
  }
  ExpectCompleteLikeQuiet("paused-run", train.get());
}

TEST_F(FaultsTest, AStoppedActorReturnsItsLanesAtOnce) {
  const auto learner = StartLearner("stopped-actor", "127.0.0.1:0");
  const auto server = StartServer("stopped-actor-server");
  const std::string address = learner->WaitForAddress().value();
  const std::string servers = server->WaitForAddress().value();
  const auto first = StartActor("stopped-actor-first", address, servers);
  const auto second = StartActor("stopped-actor-second", address, servers);
  WaitForCheckpoint("stopped-actor", 2);
  first->Signal(SIGTERM);
  EXPECT_EQ(first->Wait(absl::Seconds(10)), 0) << first->Err();
  WaitForCheckpoint("stopped-actor", 4);
  EXPECT_EQ(Metric(address, "permits_lapsed"), 0) << "its lanes were only freed when the lease expired";
  ExpectCompleteLikeQuiet("stopped-actor", learner.get());
}

TEST_F(FaultsTest, AnActorStopsEvenIfItsLearnerHangs) {
  const auto learner = StartLearner("hanging-learner", "127.0.0.1:0");
  const auto server = StartServer("hanging-learner-server");
  const std::string address = learner->WaitForAddress().value();
  const auto actor = StartActor("hanging-learner-actor", address, server->WaitForAddress().value());
  WaitForCheckpoint("hanging-learner", 2);
  learner->Signal(SIGSTOP);
  actor->Signal(SIGTERM);
  EXPECT_EQ(actor->Wait(absl::Seconds(10)), 0) << actor->Err();
}

TEST_F(FaultsTest, AStoppedServerLetsItsGamesMoveFirst) {
  const auto learner = StartLearner("stopped-server", "127.0.0.1:0");
  const std::string address = learner->WaitForAddress().value();
  const auto first = StartServerFor("stopped-server-first", address);
  const auto second = StartServerFor("stopped-server-second", address);
  ASSERT_TRUE(first->WaitForText("registered with learner", kPatience));
  ASSERT_TRUE(second->WaitForText("registered with learner", kPatience));
  const auto actor = StartActor("stopped-server-actor", address, "learner");
  WaitForCheckpoint("stopped-server", 2);
  first->Signal(SIGTERM);
  EXPECT_EQ(first->Wait(absl::Seconds(10)), 0) << first->Err();
  ExpectCompleteLikeQuiet("stopped-server", learner.get());
  EXPECT_THAT(actor->Err(), Not(AnyOf(HasSubstr("fragments returned"), HasSubstr("from their snapshots"))));
}

// A suspended actor does not move its games. The server waits for it until a second signal.
TEST_F(FaultsTest, ASecondSignalStopsAServerAtOnce) {
  const auto learner = StartLearner("told-twice", "127.0.0.1:0");
  const std::string address = learner->WaitForAddress().value();
  const auto server = StartServerFor("told-twice-server", address);
  const auto actor = StartActor("told-twice-actor", address, "learner");
  WaitForCheckpoint("told-twice", 2);
  actor->Signal(SIGSTOP);
  server->Signal(SIGTERM);
  EXPECT_EQ(server->Wait(absl::Seconds(1)), std::nullopt);
  server->Signal(SIGTERM);
  EXPECT_EQ(server->Wait(absl::Seconds(1)), 130) << server->Err();
}

TEST_F(FaultsTest, ALearnerStopsWithin10SecondsAndItsFleetWaitsForIt) {
  auto learner = StartLearner("stopped-learner", "127.0.0.1:0");
  const auto server = StartServer("stopped-learner-server");
  const std::string address = learner->WaitForAddress().value();
  const auto actor = StartActor("stopped-learner-actor", address, server->WaitForAddress().value());
  WaitForCheckpoint("stopped-learner", 4);
  learner->Signal(SIGTERM);
  EXPECT_EQ(learner->Wait(absl::Seconds(10)), 0) << learner->Err();
  EXPECT_THAT(learner->Err(), HasSubstr("continue with --resume"));
  EXPECT_EQ(actor->Wait(absl::Seconds(1)), std::nullopt) << "the actor must keep waiting: " << actor->Err();
  learner = StartLearner("stopped-learner", address, {"--resume"});
  ExpectCompleteLikeQuiet("stopped-learner", learner.get());
  EXPECT_EQ(actor->Wait(absl::Seconds(10)), 0) << actor->Err();
  EXPECT_THAT(actor->Err(), HasSubstr("epoch 2"));
}

// The connections to the learner and the server go dead without being closed.
TEST_F(FaultsTest, AnActorThatIsCutOffContinuesOnceReconnected) {
  const auto learner = StartLearner("cut-off", "127.0.0.1:0");
  const auto server = StartServer("cut-off-server");
  const std::string server_address = server->WaitForAddress().value();
  TcpForwarder to_learner(learner->WaitForAddress().value());
  TcpForwarder to_server(server_address);
  const auto actor = StartActor("cut-off-actor", to_learner.address(), to_server.address());
  WaitForCheckpoint("cut-off", 2);
  to_server.Freeze();
  to_learner.Freeze();
  EXPECT_TRUE(WaitUntil([&] { return Metric(server_address, "sessions") == 0; }, absl::Seconds(12)));
  EXPECT_TRUE(actor->WaitForText("trying again until it answers", absl::Seconds(5))) << actor->Err();
  to_server.Thaw();
  to_learner.Thaw();
  ExpectCompleteLikeQuiet("cut-off", learner.get());
}

int64_t VirtualMemory(pid_t pid) {
  const std::string statm = ReadFile("/proc/" + std::to_string(pid) + "/statm").value_or("");
  int64_t pages = 0;
  const std::vector<std::string> fields = absl::StrSplit(statm, ' ');
  return absl::SimpleAtoi(fields[0], &pages) ? pages * 4096 : 0;
}

// The server may crash or refuse requests.
TEST_F(FaultsTest, AServerOutOfMemoryDoesNotChangeTheResult) {
  const auto learner = StartLearner("memory", "127.0.0.1:0");
  const auto starved = StartServer("memory-starved");
  const auto second = StartServer("memory-second");
  const std::string address = learner->WaitForAddress().value();
  const std::string servers = starved->WaitForAddress().value() + "," + second->WaitForAddress().value();
  const auto actor = StartActor("memory-actor", address, servers);
  WaitForCheckpoint("memory", 2);
  const rlimit no_more = {static_cast<rlim_t>(VirtualMemory(starved->pid())), RLIM_INFINITY};
  ASSERT_EQ(prlimit(starved->pid(), RLIMIT_AS, &no_more, nullptr), 0) << std::strerror(errno);
  // Another actor needs games, threads and buffers on the server.
  const auto further = StartActor("memory-further", address, servers);
  ExpectCompleteLikeQuiet("memory", learner.get());
  (void)starved->Wait(absl::ZeroDuration());  // it may have ended: without memory gRPC's own threads abort
}

class FullDiskTest : public FaultsTest {
 protected:
  static std::string Events(const std::string& run) {
    return ReadFile(Logdir(run) + "/events.out.tfevents.craftfleet").value_or("none");
  }
  // Waits until the run has logged that its disk is full and continues.
  static void WaitUntilFullAndContinuing(Process* train) {
    ASSERT_TRUE(train->WaitForText("bytes of logs are waiting for space", kPatience)) << train->Err();
    ASSERT_TRUE(train->WaitForText("training continues", kPatience)) << train->Err();
    ASSERT_EQ(train->Wait(absl::ZeroDuration()), std::nullopt);
  }
  // Expects that everything was written in the end. Only the times of events differ, not their number and sizes.
  static void ExpectAllWritten(const std::string& run, Process* train) {
    ExpectCompleteLikeQuiet(run, train);
    EXPECT_EQ(Events(run).size(), Events("quiet").size());
  }
};

TEST_F(FullDiskTest, FilesAtTheirSizeLimitAreWrittenOnceTheLimitIsRaised) {
  const auto train = Train("limit", {});
  WaitForCheckpoint("limit", 2);
  train->Signal(SIGSTOP);
  // The limit must exceed the sizes of standard error, where the error is logged, and of the event file.
  const auto size = std::filesystem::file_size(Logdir("limit") + "/stats.jsonl");
  ASSERT_GT(size, 4000);
  const rlimit full = {size, RLIM_INFINITY};
  ASSERT_EQ(prlimit(train->pid(), RLIMIT_FSIZE, &full, nullptr), 0) << std::strerror(errno);
  train->Signal(SIGCONT);
  ASSERT_NO_FATAL_FAILURE(WaitUntilFullAndContinuing(train.get()));
  const rlimit room = {RLIM_INFINITY, RLIM_INFINITY};
  ASSERT_EQ(prlimit(train->pid(), RLIMIT_FSIZE, &room, nullptr), 0) << std::strerror(errno);
  ExpectAllWritten("limit", train.get());
}

TEST_F(FullDiskTest, AFullDiskIsWrittenOnceThereIsSpace) {
  const std::string disk = Logdir("disk");
  ASSERT_EQ(mkdir(disk.c_str(), 0755), 0);
  if (mount("none", disk.c_str(), "tmpfs", 0, "size=100m") != 0) {
    GTEST_SKIP() << "cannot mount a small tmpfs (it takes root): " << std::strerror(errno);
  }
  const absl::Cleanup unmount = [&disk] { umount2(disk.c_str(), MNT_DETACH); };
  const auto train = Train("disk", {});
  WaitForCheckpoint("disk", 2);
  const std::string filler = disk + "/filler";
  std::ofstream(filler) << std::string(100 << 20, 'x');  // fills the rest
  ASSERT_NO_FATAL_FAILURE(WaitUntilFullAndContinuing(train.get()));
  ASSERT_TRUE(std::filesystem::remove(filler));
  ExpectAllWritten("disk", train.get());
}

}  // namespace
}  // namespace craftfleet
