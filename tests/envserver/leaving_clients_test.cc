// EnvServiceImpl: clients that leave, servers that stop and replies that nobody takes, in the middle of requests.
#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/io/paths.h"
#include "common/wire/channel.h"
#include "common/wire/server.h"
#include "envserver/env_service.h"
#include "tests/envserver/test_session.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

v1::PlayRequest StepMany(int lanes) {
  v1::PlayRequest request;
  for (int lane = 0; lane < lanes; ++lane) request.mutable_step()->add_lanes(lane);
  request.mutable_step()->set_actions(std::string(lanes, '\x02'));
  return request;
}

// Some leave before their request is read, others while it waits for a thread, is answered, or its reply is written.
TEST_F(EnvServiceTest, ClientsThatLeaveInTheMiddleOfRequestsLeaveNothingBehind) {
  Witness witness(server());
  const double memory = Metric(*service_, "games_memory");
  const auto listening = *wire::Server::Create({"127.0.0.1:0"}, {service_.get()});
  for (int round = 0; round < 8; ++round) {
    std::vector<std::unique_ptr<Session>> sessions;
    for (int i = 0; i < 6; ++i) {
      sessions.push_back(std::make_unique<Session>(wire::Connect(listening->address())));
      sessions.back()->Write(Hello("run-a"));
      if (i == 0) continue;
      sessions.back()->Write(OpenMany(10 * i));
      for (int step = 0; step < i; ++step) sessions.back()->Write(StepMany(10 * i));
      if (i % 2 == 0) sessions.back()->Read().IgnoreError();
    }
    witness.PlayOn(round);
    sessions.clear();
  }
  EXPECT_TRUE(WaitUntil([&] { return Metric(*service_, "games_memory") == memory; }));
  EXPECT_EQ(Status().peers_size(), 1);
  witness.PlayOn(3);
}

// Such requests would take half a minute.
TEST(EnvService, AServerThatStopsEndsRequestsInTheMiddle) {
  const auto service = *EnvServiceImpl::Create(*DefaultTextureDir());
  const auto server = *wire::Server::Create({}, {service.get()});
  std::vector<std::unique_ptr<Session>> sessions;
  for (int i = 0; i < 40; ++i) {
    sessions.push_back(std::make_unique<Session>(server->InProcess()));
    ASSERT_THAT(sessions.back()->Send(Hello("run-a")), IsOk());
    sessions.back()->Write(OpenMany(EnvBatch::kMaxLanes));
  }
  server->Stop(absl::ZeroDuration());
  EXPECT_EQ(Metric(*service, "games_memory"), 0);
  EXPECT_EQ(Metric(*service, "sessions"), 0);
  for (const auto& session : sessions) EXPECT_FALSE(session->Read().ok());
}

TEST(EnvService, AClientThatTakesNoReplyHoldsNoThread) {
  EnvServiceImpl::Options options;
  options.game_threads = 1;
  const auto service = *EnvServiceImpl::Create(*DefaultTextureDir(), options);
  const auto server = *wire::Server::Create({"127.0.0.1:0"}, {service.get()});
  Session session(wire::Connect(server->address()));
  ASSERT_THAT(session.Send(Hello("run-a")), IsOk());
  ASSERT_THAT(session.Send(OpenMany(64)), IsOk());
  for (int i = 0; i < 100; ++i) session.Write(StepMany(64));  // replies of 79 MB in all
  Witness witness(server->InProcess());
  witness.PlayOn(10);
  EXPECT_LT(Metric(*service, "env_steps"), 100 * 64) << "they wait for the client";
}

}  // namespace
}  // namespace craftfleet
