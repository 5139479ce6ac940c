// Environment servers of a build that does not know canaries.

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "actor/env_client.h"
#include "common/known_canary.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

// Greets whoever comes, without a canary.
class OldService : public v1::EnvironmentService::Service {
 public:
  grpc::Status Play(grpc::ServerContext* /*context*/,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    v1::PlayRequest request;
    while (stream->Read(&request)) stream->Write({});
    return grpc::Status::OK;
  }
};

TEST(EnvCanary, AServerWithoutOneIsRefusedWhereOneIsWanted) {
  OldService service;
  const auto server = *wire::Server::Create({"127.0.0.1:0"}, {&service});
  v1::SessionHello hello = SampleHello(50);
  EnvClient any(wire::Connect(server->address()), hello, 64 * 64 * 3);
  EXPECT_THAT(any.Connect(absl::Seconds(20)), IsOk());
  hello.set_game_canary(std::string(kBuiltInGameCanary));
  EnvClient client(wire::Connect(server->address()), hello, 64 * 64 * 3);
  EXPECT_THAT(client.Connect(absl::Seconds(20)),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr(server->address()), HasSubstr("its canary is none"))));
  EXPECT_FALSE(client.connected());
}

TEST(EnvCanary, AServerOfThisBuildIsTaken) {
  const EnvServer server;
  v1::SessionHello hello = SampleHello(50);
  hello.set_game_canary(std::string(kBuiltInGameCanary));
  EnvClient client(server.Connect(), hello, 64 * 64 * 3);
  EXPECT_THAT(client.Connect(absl::Seconds(20)), IsOk());
}

}  // namespace
}  // namespace craftfleet
