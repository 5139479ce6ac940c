// One client with many names: of actors that report intact snapshots as damaged, and of environment servers that do not
// exist. The run gives the same bytes as an undisturbed run.

#include <memory>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/integration/secure_fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

class ManyNamesTest : public SecureFleetFixture {
 protected:
  ManyNamesTest()
      : SecureFleetFixture({"learner", "envserver", "actor", "bad"}, R"(
                  client { name: "actors" certificate: "actor" right: PLAY }
                  client { name: "servers" certificate: "envserver" right: SERVE }
                  client { name: "bad" certificate: "bad" right: PLAY right: SERVE })") {}
  void SetUp() override { TrainQuietly(kTenIterations); }

  std::unique_ptr<Process> StartBadPeer(const std::string& run, const std::string& role, const std::string& misdeed) {
    return Start("bad_peer", run + "-bad",
                 Tls("bad", {"--role=" + role, "--misdeed=" + misdeed, "--learner=" + learner_address_}));
  }
};

TEST_F(ManyNamesTest, ReportsUnderManyNamesOfOneClientResetNoLane) {
  StartSecureLearner("reports");
  StartWorkers("reports");
  ASSERT_TRUE(actor_->WaitForText("joined run", kPatience)) << actor_->Err();  // alone, a client confirms itself
  const auto bad = StartBadPeer("reports", "actor", "reporting");
  ExpectTheRunToEndLikeQuiet("reports");
  EXPECT_THAT(learner_->Err(), HasSubstr("can't restore lane"));
  EXPECT_THAT(learner_->Err(), Not(HasSubstr("is not a game")));
}

TEST_F(ManyNamesTest, MadeUpServersAreBoundedAndTheRealOneIsUsed) {
  StartSecureLearner("servers");
  const auto bad = StartBadPeer("servers", "envserver", "announcing");
  ASSERT_TRUE(learner_->WaitForText("already has 2048 workers, the most that one client may have", kPatience))
      << learner_->Err();
  StartWorkers("servers");
  ExpectTheRunToEndLikeQuiet("servers");
}

}  // namespace
}  // namespace craftfleet
