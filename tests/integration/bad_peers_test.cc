// Peers that are unreachable, late, of the wrong kind or of another version.

#include <csignal>
#include <memory>
#include <string>
#include <utility>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

constexpr absl::Duration kSoon = absl::Seconds(5);  // within which errors must be reported

class BadPeersTest : public SmallRunTest {
 protected:
  // An unused address.
  std::string Address(const std::string& name) const { return "unix:" + (folder_ / name); }

  std::unique_ptr<Process> StartLearner(const std::string& run, const std::string& address) {
    return Start("craftfleet-learner", Flags(run, {"--listen=" + address}));
  }
  std::unique_ptr<Process> StartServer(const std::string& address) {
    auto server = Start("craftfleet-envserver", {"--listen=" + address});
    EXPECT_THAT(server->WaitForAddress("listening on ", kPatience), IsOk());
    return server;
  }
  std::unique_ptr<Process> StartActor(const std::string& learner, const std::string& servers) {
    return Start("craftfleet-actor", {"--learner=" + learner, "--envservers=" + servers});
  }
  void ExpectToFinish(Process* process) {
    const Ended ended = Finish(process);
    EXPECT_EQ(ended.exit_code, 0) << ended.err;
  }
  // Expects the run to complete, and the process to end soon after that.
  void ExpectToComplete(Process* learner) {
    EXPECT_TRUE(learner->WaitForText("the run is complete", kPatience)) << learner->Err();
    EXPECT_EQ(learner->Wait(kSoon), 0) << learner->Err();
  }
};

TEST_F(BadPeersTest, AnActorWaitsForItsLearnerAndItsEnvironmentServer) {
  const auto actor = StartActor(Address("learner"), Address("server"));
  ASSERT_THAT(actor->WaitForAddress("status on ", kPatience), IsOk());
  EXPECT_TRUE(actor->WaitForText("warning: learner " + Address("learner") + ": ", kSoon)) << actor->Err();
  EXPECT_TRUE(actor->WaitForText("trying again until it answers", kSoon)) << actor->Err();
  const auto learner = StartLearner("run", Address("learner"));
  EXPECT_TRUE(actor->WaitForText("joined run", kPatience)) << actor->Err();
  EXPECT_TRUE(actor->WaitForText("warning: environment server " + Address("server") + ": ", kSoon)) << actor->Err();
  const auto server = StartServer(Address("server"));
  ExpectToComplete(learner.get());
  ExpectToFinish(actor.get());
}

TEST_F(BadPeersTest, APeerOfTheWrongKindEndsAnActor) {
  const auto server = StartServer(Address("server"));
  Ended ended = Finish(StartActor(Address("server"), Address("server")).get());
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("learner " + Address("server") + ": does not know this call"));
  const auto learner = StartLearner("run", Address("learner"));
  ended = Finish(StartActor(Address("learner"), Address("learner")).get());
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr("environment server " + Address("learner") + ": does not know this call"));
}

// A learner of another protocol version, which refuses the actor.
class OtherLearner : public v1::LearnerService::Service {
 public:
  explicit OtherLearner(int version) : version_(version) {}
  grpc::Status Join(grpc::ServerContext* /*context*/, const v1::JoinRequest* request, v1::JoinReply*) override {
    const absl::Status status = wire::CheckHandshake("learner", {version_, "run-a", ""}, "actor",
                                                     {request->protocol_version(), request->run_id(), ""});
    return {grpc::StatusCode::FAILED_PRECONDITION, std::string(status.message())};
  }

 private:
  const int version_;
};

TEST_F(BadPeersTest, AnActorThatALearnerOfAnotherVersionRefusesEndsWithWhatToUpgrade) {
  for (const auto& [version, side] : {std::pair{wire::kProtocolVersion - 1, "upgrade the learner"},
                                      {wire::kProtocolVersion + 1, "upgrade the actor"}}) {
    OtherLearner service(version);
    const auto server = wire::Server::Create({"127.0.0.1:0"}, {&service});
    ASSERT_THAT(server, IsOk());
    const Ended ended = Finish(StartActor((*server)->address(), "127.0.0.1:1").get());
    EXPECT_EQ(ended.exit_code, 1);
    EXPECT_THAT(ended.err, HasSubstr(side));
  }
}

TEST_F(BadPeersTest, StatusOfAProcessThatDoesNotAnswerEndsWithinSeconds) {
  const auto server = StartServer(Address("server"));
  server->Signal(SIGSTOP);
  const absl::Time start = absl::Now();
  const Ended ended = Run("craftfleet status", {"--address=" + Address("server")});
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_THAT(ended.err, HasSubstr(Address("server") + ": cannot connect: "));
  EXPECT_LT(absl::Now() - start, absl::Seconds(8));
}

}  // namespace
}  // namespace craftfleet
