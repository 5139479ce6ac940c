// One client with many names: of actors that report intact snapshots as damaged, and of environment servers that do not
// exist. The run gives the same bytes as an undisturbed run.

#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/test_certificates.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::Not;

class ManyNamesTest : public FleetRunTest {
 protected:
  ManyNamesTest() {
    for (const char* name : {"learner", "server", "actor", "bad"}) ca_.Issue(name, {name});
    EXPECT_THAT(WriteFileSynced(folder_ / "access.txt", R"(client { name: "actors" certificate: "actor" right: PLAY }
                  client { name: "servers" certificate: "server" right: SERVE }
                  client { name: "bad" certificate: "bad" right: PLAY right: SERVE })"),
                IsOk());
  }
  void SetUp() override { TrainQuietly(kTenIterations); }

  // Starts `program` with the certificate of `name`.
  std::unique_ptr<Process> StartAs(const std::string& name, const std::string& program, const std::string& log,
                                   std::vector<std::string> flags) const {
    AddTls(name, &flags);
    return Start(program, log, flags);
  }
  void StartLearnerOf(const std::string& run) {
    std::vector<std::string> flags = {"--access_file=" + (folder_ / "access.txt")};
    AddTls("learner", &flags);
    learner_ = StartLearner(run, "127.0.0.1:0", flags);
    address_ = learner_->WaitForAddress("listening on ", kPatience).value();
  }
  std::unique_ptr<Process> StartBadPeer(const std::string& run, const std::string& role, const std::string& misdeed) {
    return StartAs("bad", "bad_peer", run + "-bad",
                   {"--role=" + role, "--misdeed=" + misdeed, "--learner=" + address_});
  }
  void StartWorkers(const std::string& run) {
    server_ = StartAs("server", "craftfleet-envserver", run + "-server",
                      {"--listen=127.0.0.1:0", "--learner=" + address_, "--access_file=" + (folder_ / "access.txt")});
    actor_ = StartAs("actor", "craftfleet-actor", run + "-actor",
                     {"--learner=" + address_, "--envservers=learner", "--threads=2"});
  }
  void ExpectTheRunToEndLikeQuiet(const std::string& run) {
    EXPECT_EQ(learner_->Wait(kPatience), 0) << learner_->Err();
    EXPECT_EQ(actor_->Wait(kPatience), 0) << actor_->Err();
    ExpectLikeQuiet(run);
  }

  const TempFolder folder_;
  TestAuthority ca_{folder_, "ca"};
  std::unique_ptr<Process> learner_;
  std::unique_ptr<Process> server_;
  std::unique_ptr<Process> actor_;
  std::string address_;

 private:
  void AddTls(const std::string& name, std::vector<std::string>* flags) const {
    for (const std::string& flag : {"--tls_cert=" + (folder_ / (name + ".pem")),
                                    "--tls_key=" + (folder_ / (name + ".key")), "--tls_ca=" + (folder_ / "ca.pem")}) {
      flags->push_back(flag);
    }
  }
};

TEST_F(ManyNamesTest, ReportsUnderManyNamesOfOneClientResetNoLane) {
  StartLearnerOf("reports");
  StartWorkers("reports");
  ASSERT_TRUE(actor_->WaitForText("joined run", kPatience)) << actor_->Err();  // alone, a client confirms itself
  const auto bad = StartBadPeer("reports", "actor", "reporting");
  ExpectTheRunToEndLikeQuiet("reports");
  EXPECT_THAT(learner_->Err(), HasSubstr("can't restore lane"));
  EXPECT_THAT(learner_->Err(), Not(HasSubstr("is not a game")));
}

TEST_F(ManyNamesTest, MadeUpServersAreBoundedAndTheRealOneIsUsed) {
  StartLearnerOf("servers");
  const auto bad = StartBadPeer("servers", "envserver", "announcing");
  ASSERT_TRUE(learner_->WaitForText("already has 2048 workers, the most that one client may have", kPatience))
      << learner_->Err();
  StartWorkers("servers");
  ExpectTheRunToEndLikeQuiet("servers");
}

}  // namespace
}  // namespace craftfleet
