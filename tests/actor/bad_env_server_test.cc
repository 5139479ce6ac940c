// What games come to on environment servers that misbehave.

#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "actor/env_pool.h"
#include "actor/trouble.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;

EnvPool PoolOf(const wire::Server& server) {
  return {std::make_shared<EnvDirectory>(std::vector<wire::Endpoint>{wire::Connect(server.address())}),
          SampleHello(/*length=*/50), 64 * 64 * 3};
}

absl::Status OpenAGame(EnvPool* pool) {
  std::string frames;
  std::vector<int> lost;
  return pool->Open({{0, 100, 1, ""}}, &frames, &lost);
}

// Fails in the middle of a game, as gRPC tells of an exception.
class ThrowingService : public v1::EnvironmentService::Service {
 public:
  grpc::Status Play(grpc::ServerContext* /*context*/,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    v1::PlayRequest request;
    stream->Read(&request);
    stream->Write({});
    stream->Read(&request);
    throw std::runtime_error("out of pixels");
  }
};

TEST(BadEnvServer, AServerThatThrowsIsTroubleThatMayPass) {
  ThrowingService service;
  const auto server = *wire::Server::Create({"127.0.0.1:0"}, {&service});
  EnvPool pool = PoolOf(*server);
  const absl::Status status = OpenAGame(&pool);
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kUnavailable, HasSubstr(server->address())));
  EXPECT_TRUE(MayPass(status));
}

// Greets, then takes requests in and never answers.
class SilentService : public v1::EnvironmentService::Service {
 public:
  grpc::Status Play(grpc::ServerContext* /*context*/,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    v1::PlayRequest request;
    stream->Read(&request);
    stream->Write({});
    while (stream->Read(&request)) {
    }
    return grpc::Status::OK;
  }
};

TEST(BadEnvServer, CancelEndsACallThatWaits) {
  SilentService service;
  const auto server = *wire::Server::Create({"127.0.0.1:0"}, {&service});
  EnvPool pool = PoolOf(*server);
  absl::Status status;
  std::thread opening([&] { status = OpenAGame(&pool); });
  absl::SleepFor(absl::Milliseconds(100));  // most likely it waits by now; if not, it is refused at once
  pool.Cancel();
  opening.join();
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kCancelled, "stopping"));
  EXPECT_THAT(OpenAGame(&pool), StatusIs(absl::StatusCode::kCancelled, "stopping"));
}

// Answers everything with one byte of frames.
class BabblingService : public v1::EnvironmentService::Service {
 public:
  grpc::Status Play(grpc::ServerContext* /*context*/,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    v1::PlayRequest request;
    v1::PlayReply reply;
    reply.set_frames("x");
    while (stream->Read(&request)) stream->Write(reply);
    return grpc::Status::OK;
  }
};

TEST(BadEnvServer, ARepliesShapeIsChecked) {
  BabblingService service;
  const auto server = *wire::Server::Create({"127.0.0.1:0"}, {&service});
  EnvPool pool = PoolOf(*server);
  EXPECT_THAT(OpenAGame(&pool),
              StatusIs(absl::StatusCode::kInternal, HasSubstr(absl::StrCat("environment server ", server->address(),
                                                                           ": 1 bytes of frames, want 12288"))));
}

}  // namespace
}  // namespace craftfleet
