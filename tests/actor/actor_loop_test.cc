#include "actor/actor_loop.h"

#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "common/wire/protocol.h"
#include "tests/actor/stand_in_learner.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/failing_once_service.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

// Joins and takes all permits.
void TakePermits(const LearnerClient& client, const std::string& actor, PermitBook* permits) {
  v1::JoinRequest join;
  join.set_protocol_version(wire::kProtocolVersion);
  join.set_actor(actor);
  ASSERT_THAT(client.Join(join), IsOk());
  v1::PermitRequest request;
  request.set_actor(actor);
  request.set_epoch(1);
  request.set_capacity(kLanes);
  const auto reply = client.GetPermits(request);
  ASSERT_THAT(reply, IsOk());
  for (const v1::Permit& permit : reply->granted()) permits->Add({1, permit.lane(), permit.fragment(), 0});
}

// The second server fails when its game is to be opened, the third when it is to take that game, too: the game that the
// third one had opened in the same call is gone with it.
TEST(ActorLoop, GamesLostWhileOthersOpenAreOpenedAnew) {
  const std::string agent = "lstm_cnn";
  const TempFolder folder;
  const EnvServer env;
  FailingOnceService second(env.service.get(), 1);
  FailingOnceService third(env.service.get(), 2);
  const auto first_server = *wire::Server::Create({"unix:" + (folder / "1")}, {env.service.get()});
  const auto second_server = *wire::Server::Create({"unix:" + (folder / "2")}, {&second});
  const auto third_server = *wire::Server::Create({"unix:" + (folder / "3")}, {&third});
  std::vector<wire::Endpoint> servers;
  for (const char* name : {"1", "2", "3"}) servers.push_back(wire::Connect("unix:" + (folder / name)));
  StandInLearner learner(agent, "unix:" + (folder / "learner"), 1, NewLanes(agent));
  learner.Open(0);
  const LearnerClient client(learner.Connect());
  PermitBook permits(1);
  TakePermits(client, "a loop", &permits);

  const AgentSpec spec = *FindAgent(agent);
  PolicySource policies(&client, spec, Config(agent).tile());
  FragmentSender sender(&client, "a loop", &permits);
  sender.Start();
  ServerBook book;
  ActorLoop loop({0, Config(agent), kFrameBytes, spec.state_size}, &client, &permits, &policies, &sender,
                 std::make_unique<EnvPool>(std::make_shared<EnvDirectory>(servers), SampleHello(kLength), kFrameBytes),
                 &book);
  std::thread thread([&] { EXPECT_THAT(loop.Run(), IsOk()); });
  for (int i = 0; i < kLanes; ++i) EXPECT_TRUE(learner.fragments().Pop(absl::Minutes(1)).has_value());
  EXPECT_EQ(loop.abandoned(), 0);
  permits.Close();
  thread.join();
  sender.Stop();
}

}  // namespace
}  // namespace craftfleet
