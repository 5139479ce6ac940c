// Faults in a fleet cost time but do not change the result: workers that are suspended, stopped, out of memory or cut
// off. Killed workers are in fleet_test.cc; all faults combined are in tests/chaos.

#include <sys/resource.h>

#include <cerrno>
#include <csignal>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/numbers.h>
#include <absl/strings/str_split.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/tcp_forwarder.h"
#include "tests/fakes/wait_until.h"
#include "tests/integration/ask_status.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::AnyOf;
using testing::HasSubstr;
using testing::Not;

class FaultsTest : public FleetRunTest {
 protected:
  void SetUp() override { TrainQuietly(kTenIterations); }

  // The number of permits that the learner's actors hold.
  static int OutstandingPermits(const std::string& learner) {
    int permits = 0;
    const v1::StatusReply status = AskStatus(learner).value_or(v1::StatusReply());
    for (const v1::Peer& peer : status.peers()) {  // "4 permits, 12 fragments accepted"
      int of_one = 0;
      const std::vector<std::string> words = absl::StrSplit(peer.state(), ' ');
      if (peer.role() == "actor" && absl::SimpleAtoi(words[0], &of_one)) permits += of_one;
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
};

TEST_F(FaultsTest, AnActorPausedFor4SecondsKeepsItsLanesAndOnePausedFor15LosesThem) {
  const Fleet fleet = StartFleet("paused-actor");
  WaitForCheckpoint("paused-actor", 2);
  ASSERT_NO_FATAL_FAILURE(PauseWithPermits(fleet.actor.get(), fleet.address));
  absl::SleepFor(absl::Seconds(4));
  fleet.actor->Signal(SIGCONT);
  WaitForCheckpoint("paused-actor", 4);
  EXPECT_EQ(MetricOf(fleet.address, "permits_lapsed"), 0);
  EXPECT_EQ(MetricOf(fleet.address, "fragments_expired"), 0);

  ASSERT_NO_FATAL_FAILURE(PauseWithPermits(fleet.actor.get(), fleet.address));
  absl::SleepFor(absl::Seconds(15));
  fleet.actor->Signal(SIGCONT);
  EXPECT_TRUE(fleet.actor->WaitForText("join again", kPatience)) << "it learns that it lost them";
  EXPECT_GT(MetricOf(fleet.address, "permits_lapsed"), 0);
  ExpectCompleteLikeQuiet("paused-actor", fleet.learner.get());
}

TEST_F(FaultsTest, AServerPausedFor4SecondsKeepsItsGamesAndOnePausedFor15LosesThem) {
  const Fleet fleet = StartFleet("paused-server", /*registers=*/true);
  WaitForCheckpoint("paused-server", 2);
  fleet.server->Signal(SIGSTOP);
  absl::SleepFor(absl::Seconds(4));
  fleet.server->Signal(SIGCONT);
  WaitForCheckpoint("paused-server", 4);
  EXPECT_THAT(fleet.actor->Err(), Not(HasSubstr("fragments returned")));
  EXPECT_THAT(fleet.server->Err(), Not(HasSubstr("trying again")));

  fleet.server->Signal(SIGSTOP);
  EXPECT_TRUE(fleet.actor->WaitForText("fragments returned", absl::Seconds(15))) << fleet.actor->Err();
  absl::SleepFor(absl::Seconds(5));
  fleet.server->Signal(SIGCONT);
  ExpectCompleteLikeQuiet("paused-server", fleet.learner.get());
}

// Batch systems and laptops suspend processes.
TEST_F(FaultsTest, ARunInOneProcessThatIsPausedGoesOn) {
  const auto train = Train("paused-run", {});
  WaitForCheckpoint("paused-run", 2);
  train->Signal(SIGSTOP);
  absl::SleepFor(absl::Seconds(6));  // longer than any answer may take
  train->Signal(SIGCONT);
  ExpectCompleteLikeQuiet("paused-run", train.get());
}

TEST_F(FaultsTest, AStoppedActorReturnsItsLanesAtOnceAndEndsEvenIfItsServerAndItsLearnerHang) {
  const Fleet fleet = StartFleet("stopped-actor");
  const auto second = StartActor("stopped-actor-second", fleet.address, fleet.server_address);
  WaitForCheckpoint("stopped-actor", 2);
  fleet.actor->Signal(SIGTERM);
  EXPECT_EQ(fleet.actor->Wait(absl::Seconds(10)), 0) << fleet.actor->Err();
  WaitForCheckpoint("stopped-actor", 4);
  EXPECT_EQ(MetricOf(fleet.address, "permits_lapsed"), 0) << "its lanes were only freed when the lease expired";
  fleet.server->Signal(SIGSTOP);
  absl::SleepFor(absl::Seconds(1));  // now the actor waits for a step
  fleet.learner->Signal(SIGSTOP);
  second->Signal(SIGTERM);
  EXPECT_EQ(second->Wait(absl::Seconds(8)), 0) << second->Err();
}

TEST_F(FaultsTest, AStoppedServerLetsItsGamesMoveFirst) {
  const Fleet fleet = StartFleet("stopped-server", /*registers=*/true);
  const auto second = StartRegisteredServer("stopped-server-second", fleet.address);
  ASSERT_TRUE(second->WaitForText("registered with learner", kPatience));
  WaitForCheckpoint("stopped-server", 2);
  fleet.server->Signal(SIGTERM);
  EXPECT_EQ(fleet.server->Wait(absl::Seconds(10)), 0) << fleet.server->Err();
  ExpectCompleteLikeQuiet("stopped-server", fleet.learner.get());
  EXPECT_THAT(fleet.actor->Err(), Not(AnyOf(HasSubstr("fragments returned"), HasSubstr("from their snapshots"))));
}

// A suspended actor does not move its games. The server waits for it until a second signal.
TEST_F(FaultsTest, ASecondSignalStopsAServerAtOnce) {
  const Fleet fleet = StartFleet("told-twice", /*registers=*/true);
  WaitForCheckpoint("told-twice", 2);
  fleet.actor->Signal(SIGSTOP);
  fleet.server->Signal(SIGTERM);
  EXPECT_EQ(fleet.server->Wait(absl::Seconds(1)), std::nullopt);
  fleet.server->Signal(SIGTERM);
  EXPECT_EQ(fleet.server->Wait(absl::Seconds(1)), 130) << fleet.server->Err();
}

TEST_F(FaultsTest, ALearnerStopsWithin10SecondsAndItsFleetWaitsForIt) {
  Fleet fleet = StartFleet("stopped-learner");
  WaitForCheckpoint("stopped-learner", 4);
  fleet.learner->Signal(SIGTERM);
  EXPECT_EQ(fleet.learner->Wait(absl::Seconds(10)), 0) << fleet.learner->Err();
  EXPECT_THAT(fleet.learner->Err(), HasSubstr("continue with --resume"));
  EXPECT_EQ(fleet.actor->Wait(absl::Seconds(1)), std::nullopt) << "it must keep waiting: " << fleet.actor->Err();
  fleet.RestartLearner("stopped-learner");
  ExpectComplete("stopped-learner", fleet);
  EXPECT_THAT(fleet.actor->Err(), HasSubstr("epoch 2"));
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
  EXPECT_TRUE(WaitUntil([&] { return MetricOf(server_address, "sessions") == 0; }, absl::Seconds(12)));
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
  const Fleet fleet = StartFleet("memory", /*registers=*/true);
  const auto second = StartRegisteredServer("memory-second", fleet.address);
  WaitForCheckpoint("memory", 2);
  const rlimit no_more = {static_cast<rlim_t>(VirtualMemory(fleet.server->pid())), RLIM_INFINITY};
  ASSERT_EQ(prlimit(fleet.server->pid(), RLIMIT_AS, &no_more, nullptr), 0) << std::strerror(errno);
  // Another actor needs games, threads and buffers on the server.
  const auto further = StartActor("memory-further", fleet.address, "learner");
  ExpectCompleteLikeQuiet("memory", fleet.learner.get());
  (void)fleet.server->Wait(absl::ZeroDuration());  // it may have ended: without memory gRPC's own threads abort
}

}  // namespace
}  // namespace craftfleet
