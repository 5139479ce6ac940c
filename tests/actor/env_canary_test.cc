// Environment servers of a build without canaries.

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "actor/env_client.h"
#include "common/config/known_canary.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

// Answers every hello without a canary.
class OldService : public v1::EnvironmentService::Service {
 public:
  grpc::Status Play(grpc::ServerContext* /*context*/,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    v1::PlayRequest request;
    while (stream->Read(&request)) stream->Write({});
    return grpc::Status::OK;
  }
};

TEST(EnvCanary, AServerWithoutACanaryIsRefusedIfOneIsRequired) {
  OldService service;
  const auto server = *wire::Server::Create({"127.0.0.1:0"}, {&service});
  v1::SessionHello hello = SampleHello(50);
  EnvClient any(wire::Connect(server->address()), hello, 64 * 64 * 3);
  EXPECT_THAT(any.Connect(absl::Seconds(20)), IsOk());
  hello.set_game_canary(std::string(kBuiltInGameCanary));
  EnvClient client(wire::Connect(server->address()), hello, 64 * 64 * 3);
  EXPECT_THAT(client.Connect(absl::Seconds(20)),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr(server->address())));
  EXPECT_FALSE(client.connected());
}

TEST(EnvCanary, AServerOfThisBuildIsAccepted) {
  const EnvServer server;
  v1::SessionHello hello = SampleHello(50);
  hello.set_game_canary(std::string(kBuiltInGameCanary));
  EnvClient client(server.Connect(), hello, 64 * 64 * 3);
  EXPECT_THAT(client.Connect(absl::Seconds(20)), IsOk());
}

}  // namespace
}  // namespace craftfleet
