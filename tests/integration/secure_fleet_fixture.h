// A fleet with TLS and rights.

#ifndef CRAFTFLEET_TESTS_INTEGRATION_SECURE_FLEET_FIXTURE_H_
#define CRAFTFLEET_TESTS_INTEGRATION_SECURE_FLEET_FIXTURE_H_

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "tests/fakes/test_certificates.h"
#include "tests/integration/fleet_fixture.h"

namespace craftfleet {

class SecureFleetFixture : public FleetRunTest {
 protected:
  // Issues a certificate to each of `names`, of which "learner", "envserver" and "actor" are those of the fleet.
  // `access`: the text of the access file.
  SecureFleetFixture(const std::vector<std::string>& names, const std::string& access) {
    for (const std::string& name : names) ca_.Issue(name, {name});
    EXPECT_THAT(WriteFileSynced(folder_ / "access.txt", access), IsOk());
  }

  // Flags of a process that presents certificate `name`.
  std::vector<std::string> Tls(const std::string& name, const std::vector<std::string>& more = {}) const {
    std::vector<std::string> flags = {"--tls_cert=" + (folder_ / (name + ".pem")),
                                      "--tls_key=" + (folder_ / (name + ".key")), "--tls_ca=" + (folder_ / "ca.pem")};
    flags.insert(flags.end(), more.begin(), more.end());
    return flags;
  }
  std::string AccessFlag() const { return "--access_file=" + (folder_ / "access.txt"); }

  void StartSecureLearner(const std::string& run, std::vector<std::string> more = {}) {
    more.push_back(AccessFlag());
    learner_ = StartLearner(run, "127.0.0.1:0", Tls("learner", more));
    learner_address_ = learner_->WaitForAddress("listening on ", kPatience).value();
  }
  // Starts an environment server that registers with the learner, with `more` flags, and an actor.
  void StartWorkers(const std::string& run, std::vector<std::string> more = {}) {
    more.insert(more.end(), {AccessFlag(), "--listen=127.0.0.1:0", "--learner=" + learner_address_});
    server_ = Start("craftfleet-envserver", run + "-server", Tls("envserver", more));
    actor_ =
        Start("craftfleet-actor", run + "-actor",
              Tls("actor", {AccessFlag(), "--learner=" + learner_address_, "--envservers=learner", "--threads=2"}));
  }
  void ExpectTheRunToEndLikeQuiet(const std::string& run) {
    EXPECT_EQ(learner_->Wait(kPatience), 0) << learner_->Err();
    EXPECT_EQ(actor_->Wait(absl::Seconds(10)), 0) << actor_->Err();
    ExpectLikeQuiet(run);
    EXPECT_EQ(server_->Wait(absl::ZeroDuration()), std::nullopt) << server_->Err();
  }

  const TempFolder folder_;
  TestAuthority ca_{folder_, "ca"};
  std::unique_ptr<Process> learner_;
  std::unique_ptr<Process> server_;
  std::unique_ptr<Process> actor_;
  std::string learner_address_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_TESTS_INTEGRATION_SECURE_FLEET_FIXTURE_H_
