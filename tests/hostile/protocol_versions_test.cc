// Peers with another protocol version: the error names the program to upgrade.

#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/channel.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "craftfleet/v1/learner.grpc.pb.h"
#include "tests/integration/small_run.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

constexpr int kOlder = wire::kProtocolVersion - 1;
constexpr int kNewer = wire::kProtocolVersion + 1;

class ProtocolVersionsTest : public SmallRunTest {};

TEST_F(ProtocolVersionsTest, ALearnerRefusesActors) {
  const auto learner = Start("craftfleet-learner", Flags("run", {"--listen=127.0.0.1:0"}));
  const auto stub = v1::LearnerService::NewStub(wire::Connect(learner->WaitForAddress().value()).channel);
  for (const auto& [version, side] : {std::pair{kOlder, "upgrade the actor"}, {kNewer, "upgrade the learner"}}) {
    grpc::ClientContext context;
    v1::JoinRequest request;
    request.set_protocol_version(version);
    request.set_actor("actor-1-1");
    v1::JoinReply reply;
    const grpc::Status status = stub->Join(&context, request, &reply);
    EXPECT_EQ(status.error_code(), grpc::StatusCode::FAILED_PRECONDITION) << version;
    EXPECT_THAT(status.error_message(), HasSubstr(side));
  }
}

TEST_F(ProtocolVersionsTest, AnEnvironmentServerRefusesActors) {
  const auto server = Start("craftfleet-envserver", {"--listen=127.0.0.1:0"});
  const auto stub = v1::EnvironmentService::NewStub(wire::Connect(server->WaitForAddress().value()).channel);
  for (const auto& [version, side] :
       {std::pair{kOlder, "upgrade the actor"}, {kNewer, "upgrade the environment server"}}) {
    grpc::ClientContext context;
    const auto stream = stub->Play(&context);
    v1::PlayRequest request;
    request.mutable_hello()->set_protocol_version(version);
    request.mutable_hello()->set_run_id("run-a");
    stream->Write(request);
    v1::PlayReply reply;
    EXPECT_FALSE(stream->Read(&reply));
    const grpc::Status status = stream->Finish();
    EXPECT_EQ(status.error_code(), grpc::StatusCode::FAILED_PRECONDITION) << version;
    EXPECT_THAT(status.error_message(), HasSubstr(side));
  }
}

// Simulates a learner of another protocol version that refuses the actor.
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

TEST_F(ProtocolVersionsTest, AnActorThatIsRefusedEndsWithWhatToUpgrade) {
  for (const auto& [version, side] : {std::pair{kOlder, "upgrade the learner"}, {kNewer, "upgrade the actor"}}) {
    OtherLearner service(version);
    const auto server = wire::Server::Create({"127.0.0.1:0"}, {&service});
    ASSERT_THAT(server, IsOk());
    const Ended ended = Run("craftfleet-actor", {"--learner=" + (*server)->address(), "--envservers=127.0.0.1:1"});
    EXPECT_EQ(ended.exit_code, 1);
    EXPECT_THAT(ended.err, HasSubstr(side));
  }
}

}  // namespace
}  // namespace craftfleet
