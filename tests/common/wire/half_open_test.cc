// A peer that vanishes without closing its connection: neither end may wait for ever.

#include <atomic>
#include <memory>
#include <thread>

#include <absl/time/clock.h>
#include <gtest/gtest.h>

#include "common/wire/channel.h"
#include "common/wire/server.h"
#include "craftfleet/v1/environment.grpc.pb.h"
#include "tests/fakes/echo_service.h"
#include "tests/fakes/tcp_forwarder.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet::wire {
namespace {

constexpr absl::Duration kNoticed = absl::Seconds(10);

// Both ends wait for a message, so only keepalive can detect the failure.
TEST(HalfOpenConnection, BothEndsDetectIt) {
  EchoService service;
  const std::unique_ptr<Server> server = *Server::Create({"127.0.0.1:0"}, {&service});
  TcpForwarder way(server->address());
  const Endpoint endpoint = Connect(way.address());
  const auto stub = v1::EnvironmentService::NewStub(endpoint.channel);
  grpc::ClientContext context;
  const auto stream = stub->Play(&context);
  v1::PlayReply reply;
  ASSERT_TRUE(stream->Write({}));
  ASSERT_TRUE(stream->Read(&reply));

  way.Freeze();
  const absl::Time start = absl::Now();
  std::atomic<bool> client_noticed{false};
  std::thread reading([&] {
    EXPECT_FALSE(stream->Read(&reply));
    EXPECT_EQ(stream->Finish().error_code(), grpc::StatusCode::UNAVAILABLE);
    client_noticed = true;
  });
  EXPECT_TRUE(WaitUntil([&] { return client_noticed && service.ended() == 1; }, kNoticed));
  EXPECT_GT(absl::Now() - start, absl::Seconds(4)) << "a slow peer is not a dead one";
  context.TryCancel();
  reading.join();
}

}  // namespace
}  // namespace craftfleet::wire
