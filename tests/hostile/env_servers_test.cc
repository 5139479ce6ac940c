// Environment servers that stay connected but do not answer: the run gives the same bytes as an undisturbed run.

#include <csignal>
#include <memory>
#include <string>
#include <vector>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/time/time.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/loopback.h"
#include "tests/fakes/wait_until.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

class HostileEnvServersTest : public FleetRunTest {
 protected:
  void SetUp() override { TrainQuietly(kTenIterations); }

  static std::unique_ptr<Process> StartActorWith(const std::string& log, const std::string& learner,
                                                 const std::string& servers) {
    return Start("craftfleet-actor", log,
                 {"--learner=" + learner, "--envservers=" + servers, "--threads=2", "--env_timeout=3"});
  }
  // The learner's status of the server at `address`; empty if there is none.
  static std::string HealthOf(const std::string& learner, const std::string& address) {
    const auto status = Start("craftfleet status", "status", {"--address=" + learner});
    if (status->Wait(kPatience) != 0) return "";
    const std::string text = status->Out();
    const size_t line = text.find(address);
    return line == std::string::npos ? "" : text.substr(line, text.find('\n', line) - line);
  }
};

TEST_F(HostileEnvServersTest, ASuspendedServerCostsSecondsAndIsUsedAgain) {
  const auto learner = StartLearner("still", "127.0.0.1:0");
  const std::string address = learner->WaitForAddress().value();
  const auto good = Start("craftfleet-envserver", "still-good", {"--listen=127.0.0.1:0"});
  const auto bad = Start("craftfleet-envserver", "still-bad", {"--listen=127.0.0.1:0"});
  const std::string bad_address = bad->WaitForAddress().value();
  const std::string servers = absl::StrCat(good->WaitForAddress().value(), ",", bad_address);
  const auto first = StartActorWith("still-first", address, servers);
  const auto second = StartActorWith("still-second", address, servers);
  WaitForCheckpoint("still", 2);
  bad->Signal(SIGSTOP);
  EXPECT_TRUE(first->WaitForText("not used until it answers", absl::Seconds(60))) << first->Err();
  EXPECT_TRUE(WaitUntil([&] { return absl::StrContains(HealthOf(address, bad_address), "NOT ANSWERING"); }))
      << HealthOf(address, bad_address);
  bad->Signal(SIGCONT);
  EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
  ExpectLikeQuiet("still");
  EXPECT_EQ(first->Wait(kPatience), 0) << first->Err();
  EXPECT_EQ(second->Wait(kPatience), 0) << second->Err();
}

TEST_F(HostileEnvServersTest, AServerThatNeverAnswersDelaysNoActor) {
  const LoopbackListener mute;
  const auto learner = StartLearner("mute", "127.0.0.1:0");
  const std::string address = learner->WaitForAddress().value();
  const auto good = StartServer("mute-good");
  const std::string servers = absl::StrCat(mute.address(), ",", good->WaitForAddress().value());
  const auto first = StartActorWith("mute-first", address, servers);
  const auto second = StartActorWith("mute-second", address, servers);
  EXPECT_EQ(learner->Wait(kPatience), 0) << learner->Err();
  ExpectLikeQuiet("mute");
  EXPECT_EQ(first->Wait(kPatience), 0) << first->Err();
}

}  // namespace
}  // namespace craftfleet
