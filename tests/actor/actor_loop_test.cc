#include "actor/actor_loop.h"

#include <map>
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
void TakePermits(const LearnerClient& client, const std::string& actor, LearnerStream* stream, PermitTracker* permits) {
  v1::JoinRequest join;
  join.set_protocol_version(wire::kProtocolVersion);
  join.set_actor(actor);
  ASSERT_THAT(client.Join(join), IsOk());
  v1::PermitRequest request;
  request.set_actor(actor);
  request.set_epoch(1);
  request.set_capacity(kLanes);
  const auto reply = stream->Ask(request);
  ASSERT_THAT(reply, IsOk());
  for (const v1::Permit& permit : reply->granted()) permits->Add({{permit.lane(), permit.fragment(), 0}, 1});
}

// The second server fails when it opens its game, and the third when it opens that game in its place. The game that the
// third server had opened in the same call is then lost as well.
TEST(ActorLoop, GamesLostWhileOthersOpenAreOpenedAgain) {
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
  PermitTracker permits(1);
  LearnerStream stream(&client, "a loop", &permits);
  stream.Start();
  TakePermits(client, "a loop", &stream, &permits);

  const AgentSpec spec = *FindAgent(agent);
  PolicySource policies(&client, spec, Config(agent).tile());
  EnvServerTracker tracker;
  ActorLoop loop({0, Config(agent), kFrameBytes, spec.state_size, KeepsEveryState(spec, Config(agent).ppo())}, &client,
                 &permits, &policies, &stream,
                 std::make_unique<EnvPool>(std::make_shared<EnvDirectory>(servers), SampleHello(kLength), kFrameBytes),
                 &tracker);
  std::thread thread([&] { EXPECT_THAT(loop.Run(), IsOk()); });
  for (int i = 0; i < kLanes; ++i) EXPECT_TRUE(learner.fragments().Pop(absl::Minutes(1)).has_value());
  EXPECT_EQ(loop.abandoned(), 0);
  permits.Close();
  thread.join();
  stream.Stop();
}

// The other lanes continue. Lane 0 is reset to its previous snapshot, while the actor has its later game.
TEST(ActorLoop, AResetLaneIsLoadedFromItsSnapshot) {
  const std::string agent = "ppo_cnn";
  const TempFolder folder;
  const EnvServer env;
  StandInLearner learner(agent, "unix:" + (folder / "learner"), 1, NewLanes(agent));
  learner.Open(0);
  const LearnerClient client(learner.Connect());
  PermitTracker permits(1);
  const AgentSpec spec = *FindAgent(agent);
  PolicySource policies(&client, spec, Config(agent).tile());
  LearnerStream stream(&client, "a loop", &permits);
  stream.Start();
  EnvServerTracker tracker;
  const std::vector<wire::Endpoint> servers = {env.Connect()};
  ActorLoop loop({0, Config(agent), kFrameBytes, spec.state_size}, &client, &permits, &policies, &stream,
                 std::make_unique<EnvPool>(std::make_shared<EnvDirectory>(servers), SampleHello(kLength), kFrameBytes),
                 &tracker);
  std::thread thread([&] { EXPECT_THAT(loop.Run(), IsOk()); });

  v1::JoinRequest join;
  join.set_protocol_version(wire::kProtocolVersion);
  join.set_actor("a loop");
  ASSERT_THAT(client.Join(join), IsOk());
  v1::PermitRequest request;
  request.set_actor("a loop");
  request.set_epoch(1);
  request.set_capacity(kLanes);
  // Gives all granted permits to the loop.
  const auto play = [&](const v1::PermitReply& reply) {
    for (const v1::Permit& granted : reply.granted()) {
      HeldPermit permit{{granted.lane(), granted.fragment(), granted.policy_version()}, 1};
      permit.reload = granted.reload();
      permits.Add(permit);
    }
  };
  // The first frames of the next fragments, by lane.
  const auto first_frames = [&] {
    std::map<int, std::string> frames;
    for (int i = 0; i < kLanes; ++i) {
      const auto fragment = learner.fragments().Pop(absl::Minutes(1));
      if (fragment.has_value()) frames[fragment->lane] = fragment->frames.substr(0, kFrameBytes);
    }
    return frames;
  };
  play(stream.Ask(request).value());
  first_frames();
  play(stream.Ask(request).value());
  std::map<int, std::string> before = first_frames();
  ASSERT_EQ(before.size(), kLanes);

  learner.Open(1);
  v1::PermitReply held = stream.Ask(request).value();
  ASSERT_EQ(held.granted_size(), kLanes);
  v1::LaneFailure* failure = request.add_failures();  // of the only actor, twice
  failure->set_fragment(held.granted(0).fragment());
  for (const v1::Permit& permit : held.granted()) {
    if (permit.lane() != 0) *request.add_active() = permit;
  }
  ASSERT_THAT(stream.Ask(request), IsOk());
  const v1::PermitReply reset = stream.Ask(request).value();
  ASSERT_EQ(reset.granted_size(), 1);
  ASSERT_TRUE(reset.granted(0).reload());
  *held.mutable_granted(0) = reset.granted(0);
  play(held);
  std::map<int, std::string> after = first_frames();
  ASSERT_EQ(after.size(), kLanes);
  EXPECT_TRUE(after[0] == before[0]) << "the game before the last fragment";
  for (int lane = 1; lane < kLanes; ++lane) EXPECT_FALSE(after[lane] == before[lane]) << lane;
  permits.Close();
  thread.join();
  stream.Stop();
}

}  // namespace
}  // namespace craftfleet
