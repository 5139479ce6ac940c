#include "actor/actor_loop.h"

#include <map>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/agent/weights.h"
#include "common/wire/fragment_check.h"
#include "common/wire/protocol.h"
#include "tests/actor/stand_in_learner.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/failing_once_service.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::AnyOf;
using testing::Each;
using testing::ElementsAre;

// A loop that plays all lanes on some servers, and the learner whose permits a test gives it.
class ActorLoopTest : public testing::Test {
 protected:
  ~ActorLoopTest() override { Stop(); }
  void Stop() {
    permits_.Close();
    if (thread_.joinable()) thread_.join();
    if (stream_ != nullptr) stream_->Stop();
    loop_.reset();
  }
  void Start(const std::string& agent, const std::vector<wire::Endpoint>& servers) {
    Start(agent, std::make_shared<EnvDirectory>(servers));
  }
  void Start(const std::string& agent, std::shared_ptr<EnvDirectory> directory) {
    learner_ = std::make_unique<StandInLearner>(agent, "unix:" + (folder_ / "learner"), 1, NewLanes(agent));
    client_ = std::make_unique<LearnerClient>(learner_->Connect());
    learner_->Open(0);
    stream_ = std::make_unique<LearnerStream>(client_.get(), "a loop", &permits_);
    stream_->Start();
    const AgentSpec spec = *FindAgent(agent);
    policies_ = std::make_unique<PolicySource>(client_.get(), spec, Config(agent).tile());
    loop_ = std::make_unique<ActorLoop>(
        ActorLoop::Options{0, Config(agent), kFrameBytes, spec.state_size, KeepsEveryState(spec, Config(agent).ppo())},
        client_.get(), &permits_, policies_.get(), stream_.get(),
        std::make_unique<EnvPool>(std::move(directory), SampleHello(kLength), kFrameBytes), &tracker_);
    thread_ = std::thread([this] { EXPECT_THAT(loop_->Run(), IsOk()); });
    v1::JoinRequest join;
    join.set_protocol_version(wire::kProtocolVersion);
    join.set_actor("a loop");
    ASSERT_THAT(client_->Join(join), IsOk());
    request_.set_actor("a loop");
    request_.set_epoch(1);
    request_.set_capacity(kLanes);
  }
  v1::PermitReply Ask() { return stream_->Ask(request_).value(); }
  // Gives all granted permits to the loop.
  void Play(const v1::PermitReply& reply) {
    for (const v1::Permit& granted : reply.granted()) {
      HeldPermit permit{{granted.lane(), granted.fragment(), granted.policy_version()}, 1};
      permit.reload = granted.reload();
      permits_.Add(permit);
    }
  }
  // The first frames of the next fragments, by lane.
  std::map<int, std::string> FirstFrames() {
    std::map<int, std::string> frames;
    for (int i = 0; i < kLanes; ++i) {
      const auto fragment = learner_->fragments().Pop(absl::Minutes(1));
      if (fragment.has_value()) frames[fragment->lane] = fragment->frames.substr(0, kFrameBytes);
    }
    EXPECT_EQ(frames.size(), kLanes);
    return frames;
  }

  const TempFolder folder_;
  EnvServer env_;
  std::unique_ptr<StandInLearner> learner_;
  std::unique_ptr<LearnerClient> client_;
  PermitTracker permits_{1};
  std::unique_ptr<LearnerStream> stream_;
  std::unique_ptr<PolicySource> policies_;
  EnvServerTracker tracker_;
  std::unique_ptr<ActorLoop> loop_;
  std::thread thread_;
  v1::PermitRequest request_;
};

// The second server fails when it opens its game, and the third when it opens that game in its place. The game that the
// third server had opened in the same call is then lost as well.
TEST_F(ActorLoopTest, GamesLostWhileOthersOpenAreOpenedAgain) {
  FailingOnceService second(env_.service.get(), 1);
  FailingOnceService third(env_.service.get(), 2);
  const auto first_server = *wire::Server::Create({"unix:" + (folder_ / "1")}, {env_.service.get()});
  const auto second_server = *wire::Server::Create({"unix:" + (folder_ / "2")}, {&second});
  const auto third_server = *wire::Server::Create({"unix:" + (folder_ / "3")}, {&third});
  std::vector<wire::Endpoint> servers;
  for (const char* name : {"1", "2", "3"}) servers.push_back(wire::Connect("unix:" + (folder_ / name)));
  ASSERT_NO_FATAL_FAILURE(Start("lstm_cnn", servers));
  Play(Ask());
  FirstFrames();
  EXPECT_EQ(loop_->abandoned(), 0);
  Stop();  // before the servers
}

// The other lanes continue. Lane 0 is reset to its previous snapshot, while the actor has its later game.
TEST_F(ActorLoopTest, AResetLaneIsLoadedFromItsSnapshot) {
  ASSERT_NO_FATAL_FAILURE(Start("ppo_cnn", {env_.Connect()}));
  Play(Ask());
  FirstFrames();
  Play(Ask());
  std::map<int, std::string> before = FirstFrames();

  learner_->Open(1);
  v1::PermitReply held = Ask();
  ASSERT_EQ(held.granted_size(), kLanes);
  v1::LaneFailure* failure = request_.add_failures();  // of the only actor, twice
  failure->set_fragment(held.granted(0).fragment());
  for (const v1::Permit& permit : held.granted()) {
    if (permit.lane() != 0) *request_.add_active() = permit;
  }
  Ask();
  const v1::PermitReply reset = Ask();
  ASSERT_EQ(reset.granted_size(), 1);
  ASSERT_TRUE(reset.granted(0).reload());
  *held.mutable_granted(0) = reset.granted(0);
  Play(held);
  std::map<int, std::string> after = FirstFrames();
  EXPECT_TRUE(after[0] == before[0]) << "the game before the last fragment";
  for (int lane = 1; lane < kLanes; ++lane) EXPECT_FALSE(after[lane] == before[lane]) << lane;
}

TEST_F(ActorLoopTest, WhatADivergingAgentPredictsIsWithinTheLearnersRange) {
  ASSERT_NO_FATAL_FAILURE(Start("ppo_cnn", {env_.Connect()}));
  for (int i = 0; i < kFragmentsPerIteration; ++i) {
    Play(Ask());
    FirstFrames();
  }
  const AgentSpec spec = *FindAgent("ppo_cnn");
  std::vector<float> weights = *LoadWeights(spec, SampleWeights(1));
  for (float& weight : weights) weight *= 1e4F;
  learner_->Open(1, SaveWeights(spec, weights));
  Play(Ask());
  for (int i = 0; i < kLanes; ++i) {
    const auto fragment = learner_->fragments().Pop(absl::Minutes(1));
    ASSERT_TRUE(fragment.has_value());
    const auto is_bound = AnyOf(wire::kMaxValue, -wire::kMaxValue);
    EXPECT_THAT(fragment->values, Each(is_bound));
    EXPECT_THAT(fragment->truncation_values, ElementsAre(is_bound));
    EXPECT_THAT(fragment->bootstrap_value, is_bound);
  }
}

// While the learner was paused, it was shown as usable.
TEST_F(ActorLoopTest, AServerThatEndsWhileNothingIsPlayedIsNotShownAsUsable) {
  ASSERT_NO_FATAL_FAILURE(Start("ppo_cnn", {env_.Connect()}));
  const auto is_ok = [this] {
    const std::vector<v1::Peer> servers = tracker_.All();
    return servers.size() == 1 && servers[0].health() == v1::Peer::OK;
  };
  Play(Ask());
  FirstFrames();
  EXPECT_TRUE(WaitUntil(is_ok));
  env_.server->Stop(absl::ZeroDuration());
  EXPECT_TRUE(WaitUntil([&] { return !is_ok(); }));
}

// A server that is drained is no longer listed. It kept the games of an actor that had no permits, such as one that was
// drained before, until the actor got some.
TEST_F(ActorLoopTest, GamesLeaveAServerThatIsNoLongerListedWhileNothingIsPlayed) {
  const EnvServer other;
  const auto directory = EnvDirectory::Parse("envservers", "learner").value();
  directory->SetRegistered({env_.server->address()});
  ASSERT_NO_FATAL_FAILURE(Start("ppo_cnn", directory));
  const auto has_sessions = [this] {
    v1::StatusReply status;
    env_.service->FillStatus(&status);
    return status.peers_size() > 0;
  };
  Play(Ask());
  FirstFrames();
  EXPECT_TRUE(has_sessions());
  directory->SetRegistered({other.server->address()});
  EXPECT_TRUE(WaitUntil([&] { return !has_sessions(); }, absl::Seconds(10)));
  Play(Ask());
  FirstFrames();
  Stop();  // before the server
}

TEST_F(ActorLoopTest, ThatNoServerCanBeUsedIsNotLoggedAtEveryAttempt) {
  testing::internal::CaptureStderr();
  ASSERT_NO_FATAL_FAILURE(Start("ppo_cnn", {wire::Connect("127.0.0.1:1")}));
  for (int64_t abandoned = 0; abandoned < 2 * kLanes; abandoned += kLanes) {
    Play(Ask());
    ASSERT_TRUE(WaitUntil([&] { return loop_->abandoned() > abandoned; }));
  }
  Stop();
  const std::vector<std::string> parts =
      absl::StrSplit(testing::internal::GetCapturedStderr(), "fragments returned: environment server 127.0.0.1:1");
  EXPECT_EQ(parts.size(), 2U) << "one line";
}

}  // namespace
}  // namespace craftfleet
