// Games on environment servers that misbehave.

#include <malloc.h>

#include <atomic>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "actor/env_client.h"
#include "actor/env_pool.h"
#include "actor/error_policy.h"
#include "common/config/known_canary.h"
#include "tests/fakes/echo_service.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

constexpr int kFrameBytes = 64 * 64 * 3;
constexpr absl::Duration kTimeout = absl::Seconds(2);

// Forwards a real server's replies, modified by the test.
class TwistingService : public v1::EnvironmentService::Service {
 public:
  // Modifies a reply; returns false to send none. May throw, which gRPC reports as an error.
  using Twist = std::function<bool(const v1::PlayRequest&, v1::PlayReply*)>;

  TwistingService(EnvServiceImpl* real, Twist twist) : real_(real), twist_(std::move(twist)) {}

  grpc::Status Play(grpc::ServerContext* context,
                    grpc::ServerReaderWriter<v1::PlayReply, v1::PlayRequest>* stream) override {
    const bool is_probe = sessions_++ == 0;
    const auto server = *wire::Server::Create({}, {real_});
    const auto stub = v1::EnvironmentService::NewStub(server->InProcess().channel);
    grpc::ClientContext inner_context;
    const auto inner = stub->Play(&inner_context);
    v1::PlayRequest request;
    v1::PlayReply reply;
    while (stream->Read(&request) && inner->Write(request) && inner->Read(&reply)) {
      const bool is_well = !bad || (spares_probe && is_probe);
      if (!is_well && !twist_(request, &reply)) {
        while (!context->IsCancelled()) absl::SleepFor(absl::Milliseconds(5));
        break;
      }
      stream->Write(reply);
    }
    inner->WritesDone();
    return inner->Finish();
  }

  std::atomic<bool> bad{true};
  std::atomic<bool> spares_probe{true};  // do not modify the first session
  int sessions() const { return sessions_; }

 private:
  EnvServiceImpl* const real_;
  const Twist twist_;
  std::atomic<int> sessions_{0};
};

// A misbehaving server, a correct one, and a pool of both.
class BadEnvServer : public testing::Test {
 protected:
  void Start(TwistingService::Twist twist, bool alone = false) {
    pool_.reset();
    server_.reset();
    service_ = std::make_unique<TwistingService>(env_.service.get(), std::move(twist));
    server_ = *wire::Server::Create({"127.0.0.1:0"}, {service_.get()});
    std::vector<wire::Endpoint> endpoints = {wire::Connect(server_->address())};
    if (!alone) endpoints.push_back(good_.Connect());
    ServerHealth::Options options = {SampleHello(50), kFrameBytes, kTimeout, absl::Milliseconds(100),
                                     absl::Milliseconds(400)};
    health_ = std::make_shared<ServerHealth>(options);
    pool_ =
        std::make_unique<EnvPool>(std::make_shared<EnvDirectory>(endpoints), SampleHello(50), kFrameBytes, 0, health_);
  }
  absl::Status Open(const std::vector<EnvClient::Lane>& lanes) {
    const absl::StatusOr<EnvPool::Opened> opened = pool_->Open(lanes);
    if (!opened.ok()) return opened.status();
    refused_.clear();
    for (const EnvPool::OpenedLane& lane : opened->lanes) {
      if (!lane.refusal.empty()) refused_.push_back(lane);
    }
    return absl::OkStatus();
  }
  // Steps lanes 0..3; opens lost lanes again.
  absl::Status StepFour() {
    const std::vector<Action> actions(4, Action::kNoop);
    const absl::StatusOr<EnvPool::Stepped> stepped = pool_->Step(pool_->Arrange({0, 1, 2, 3}), actions, false);
    if (!stepped.ok()) return stepped.status();
    std::vector<EnvClient::Lane> lanes;
    for (const int lane : stepped->lost) lanes.push_back({lane, lane + 100, 1, ""});
    lost_ += stepped->lost.size();
    return lanes.empty() ? absl::OkStatus() : Open(lanes);
  }
  absl::Status OpenFour() { return Open({{0, 100, 1, ""}, {1, 101, 1, ""}, {2, 102, 1, ""}, {3, 103, 1, ""}}); }
  absl::Status Error() const { return health_->Of(server_->address()).error; }
  std::string Snapshot() {
    EnvClient client(good_.Connect(), SampleHello(50), kFrameBytes);
    EXPECT_THAT(client.Connect(absl::Seconds(5)), IsOk());
    std::string frames;
    StepBatch batch;
    EXPECT_THAT(client.Open({{0, 100, 1, ""}}, &frames), IsOk());
    EXPECT_THAT(client.SendStep({0}, {Action::kNoop}, true), IsOk());
    EXPECT_THAT(client.ReceiveStep(&batch), IsOk());
    return batch.snapshots.at(0);
  }

  const EnvServer env_ = {};
  const EnvServer good_ = {};
  std::unique_ptr<TwistingService> service_;
  std::unique_ptr<wire::Server> server_;
  std::shared_ptr<ServerHealth> health_;
  std::unique_ptr<EnvPool> pool_;
  std::vector<EnvPool::OpenedLane> refused_;  // by the last Open
  size_t lost_ = 0;
};

// Each bad server that an actor met cost it tens of megabytes for the time that it remembered the server.
TEST_F(BadEnvServer, ARefusedReplyOf32MegabytesIsNotKept) {
  constexpr size_t kReplyBytes = 32 << 20;
  const auto in_use = [] {
    const struct mallinfo2 heap = mallinfo2();
    return heap.uordblks + heap.hblkhd;
  };
  Start([](const v1::PlayRequest&, v1::PlayReply* reply) {
    reply->set_frames(std::string(kReplyBytes, 'x'));
    return true;
  });
  service_->spares_probe = false;
  const size_t before = in_use();
  std::vector<std::unique_ptr<EnvClient>> clients;
  for (int i = 0; i < 6; ++i) {
    clients.push_back(
        std::make_unique<EnvClient>(wire::Connect(server_->address()), SampleHello(50), kFrameBytes, kTimeout));
    EXPECT_THAT(clients.back()->Connect(absl::Seconds(5)), StatusIs(absl::StatusCode::kDataLoss, testing::_));
  }
  EXPECT_TRUE(WaitUntil([&] { return in_use() < before + 2 * kReplyBytes; })) << in_use() - before << " bytes";
}

TEST_F(BadEnvServer, ASilentServerCostsOneDeadlineAndIsUsedAgainOnceItAnswers) {
  Start([](const v1::PlayRequest& request, v1::PlayReply*) { return !request.has_step(); });
  ASSERT_THAT(OpenFour(), IsOk());
  service_->spares_probe = false;
  const absl::Time start = absl::Now();
  ASSERT_THAT(StepFour(), IsOk());
  EXPECT_GE(absl::Now() - start, kTimeout / 2);
  EXPECT_EQ(lost_, 2u);
  EXPECT_TRUE(absl::IsDeadlineExceeded(Error())) << Error();
  for (const EnvServerTracker::Server& server : pool_->Report()) {
    EXPECT_EQ(server.error.empty(), server.address != server_->address());
  }
  // Play continues while probes fail.
  ASSERT_TRUE(WaitUntil([&] {
    EXPECT_THAT(pool_->Refresh(), IsEmpty());
    EXPECT_THAT(StepFour(), IsOk());
    return service_->sessions() >= 4;
  }));
  EXPECT_EQ(lost_, 2u);
  service_->bad = false;
  EXPECT_TRUE(WaitUntil([&] {
    std::vector<EnvClient::Lane> lanes;
    for (const int lane : pool_->Refresh()) lanes.push_back({lane, lane + 100, 1, ""});
    EXPECT_THAT(Open(lanes), IsOk());
    return !lanes.empty();
  })) << "it gets games again";
  EXPECT_THAT(Error(), IsOk());
}

TEST_F(BadEnvServer, ASlowServerLosesItsGamesInTheMiddleOfAFragment) {
  Start([](const v1::PlayRequest& request, v1::PlayReply*) {
    if (request.has_step()) absl::SleepFor(absl::Milliseconds(200));
    return true;
  });
  ASSERT_THAT(OpenFour(), IsOk());
  for (const absl::Time end = absl::Now() + absl::Seconds(60); lost_ == 0 && absl::Now() < end;) {
    ASSERT_THAT(StepFour(), IsOk());
  }
  EXPECT_EQ(lost_, 2u);
  EXPECT_THAT(Error(), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("slow, a step takes 2")));
  for (const EnvServerTracker::Server& server : pool_->Report()) {
    EXPECT_EQ(server.slow, server.address == server_->address());
  }
}

// Leaves no end of an episode in the reply to a step.
void DropEnds(v1::PlayReply* reply) {
  reply->mutable_ends()->assign(reply->ends().size(), static_cast<char>(StepEnd::kNone));
  reply->clear_episodes();
  reply->clear_last_frames();
}

// Evaluations waited for such a game for ever, and what such a server made up was learned from. A new game, whose steps
// the reply need not count, and one from a snapshot.
TEST_F(BadEnvServer, AGameThatNeverEndsIsAFaultOfItsServer) {
  for (const bool is_restored : {false, true}) {
    SCOPED_TRACE(is_restored);
    lost_ = 0;
    Start([is_restored](const v1::PlayRequest& request, v1::PlayReply* reply) {
      if (request.has_step()) DropEnds(reply);
      if (!is_restored) reply->clear_episode_steps();
      return true;
    });
    const std::string snapshot = is_restored ? Snapshot() : "";  // after one step
    ASSERT_THAT(Open({{0, 100, 1, snapshot}, {1, 101, 1, snapshot}, {2, 102, 1, snapshot}, {3, 103, 1, snapshot}}),
                IsOk());
    for (int step = is_restored ? 2 : 1; step < 50; ++step) ASSERT_THAT(StepFour(), IsOk());
    EXPECT_EQ(lost_, 0u);
    ASSERT_THAT(StepFour(), IsOk());
    EXPECT_EQ(lost_, 2u);
    EXPECT_THAT(Error(),
                StatusIs(absl::StatusCode::kDataLoss,
                         AllOf(HasSubstr(server_->address()), HasSubstr("goes on after 50 steps, want at most 50"))));
  }
}

TEST_F(BadEnvServer, ANewGameThatHasStepsIsAFaultOfItsServer) {
  Start([](const v1::PlayRequest& request, v1::PlayReply* reply) {
    if (request.has_open()) reply->set_episode_steps(0, 3);
    return true;
  });
  ASSERT_THAT(OpenFour(), IsOk()) << "on the other server";
  EXPECT_THAT(Error(), StatusIs(absl::StatusCode::kDataLoss,
                                AllOf(HasSubstr(server_->address()), HasSubstr("episode_steps: 3 of lane"),
                                      HasSubstr("want 0 of a new game"))));
}

TEST_F(BadEnvServer, AServerThatIsSilentFromTheStartDelaysNothing) {
  Start([](const v1::PlayRequest&, v1::PlayReply*) { return false; });
  service_->spares_probe = false;
  for (int i = 0; i < 3; ++i) {
    ASSERT_THAT(OpenFour(), IsOk());
    pool_->Refresh();
    ASSERT_THAT(StepFour(), IsOk());
  }
  EXPECT_EQ(lost_, 0u);
  EXPECT_TRUE(WaitUntil([&] { return absl::IsDeadlineExceeded(Error()); }));
}

TEST_F(BadEnvServer, IfAllServersAreSilentTheFirstThatAnswersIsUsed) {
  Start([](const v1::PlayRequest&, v1::PlayReply*) { return false; }, /*alone=*/true);
  service_->spares_probe = false;
  const absl::Status status = OpenFour();
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kUnavailable, HasSubstr(server_->address())));
  EXPECT_TRUE(IsTransient(CallKind::kSession, status)) << "the actor waits";
  service_->bad = false;
  EXPECT_TRUE(WaitUntil([&] { return OpenFour().ok(); }));
}

struct InvalidReply {
  std::string name;
  std::function<void(v1::PlayReply*)> make;  // modifies the reply to a step
  std::string field;                         // named in the error
};

class InvalidReplyTest : public BadEnvServer, public testing::WithParamInterface<InvalidReply> {};

TEST_P(InvalidReplyTest, IsReportedAndTheGamesContinueElsewhere) {
  Start([](const v1::PlayRequest& request, v1::PlayReply* reply) {
    if (request.has_step()) GetParam().make(reply);
    return true;
  });
  ASSERT_THAT(OpenFour(), IsOk());
  ASSERT_THAT(StepFour(), IsOk());
  EXPECT_EQ(lost_, 2u);
  EXPECT_THAT(Error(),
              StatusIs(absl::StatusCode::kDataLoss, AllOf(HasSubstr(server_->address()), HasSubstr(GetParam().field))));
}

// What a field by itself may be, field_edges_test checks.
INSTANTIATE_TEST_SUITE_P(
    Fields, InvalidReplyTest,
    testing::Values(InvalidReply{"Frames", [](v1::PlayReply* r) { r->mutable_frames()->pop_back(); }, "frames"},
                    InvalidReply{"Rows", [](v1::PlayReply* r) { r->add_rewards(0); }, "rewards"},
                    InvalidReply{"Ended", [](v1::PlayReply* r) { r->mutable_ends()->at(0) = 1; }, "episodes"},
                    // After one step; the learner would refuse the fragment, and its lane never leave this server.
                    InvalidReply{"EpisodeLength",
                                 [](v1::PlayReply* r) {
                                   r->mutable_ends()->at(0) = 1;
                                   v1::EpisodeMessage* episode = r->add_episodes();
                                   episode->set_length(7);
                                   for (int i = 0; i < kNumAchievements; ++i) episode->add_achievements(0);
                                 },
                                 "episodes.length: 7 of lane"},
                    // An end is hidden, or a game begins anew.
                    InvalidReply{"EpisodeSteps", [](v1::PlayReply* r) { r->set_episode_steps(0, 0); },
                                 "episode_steps: 0 of lane"},
                    InvalidReply{"EpisodeStepsRows", [](v1::PlayReply* r) { r->add_episode_steps(1); },
                                 "episode_steps: 3 numbers, want 2"},
                    InvalidReply{"Snapshots", [](v1::PlayReply* r) { r->add_snapshots("x"); }, "snapshots"},
                    InvalidReply{"Refused", [](v1::PlayReply* r) { r->add_refused(); }, "refused"}),
    [](const auto& info) { return info.param.name; });

TEST_F(BadEnvServer, ASnapshotRefusedByOneServerIsTriedOnAnother) {
  Start([](const v1::PlayRequest& request, v1::PlayReply* reply) {
    if (!request.has_open()) return true;
    reply->clear_frames();
    for (const auto& lane : request.open().lanes()) {
      reply->add_refused()->set_lane(lane.lane());
    }
    return true;
  });
  const std::string snapshot = Snapshot();
  ASSERT_THAT(Open({{0, 100, 1, snapshot}, {1, 100, 1, snapshot}}), IsOk());
  EXPECT_THAT(refused_, IsEmpty());
  EXPECT_TRUE(absl::IsDataLoss(Error())) << Error();
}

TEST_F(BadEnvServer, ASnapshotRefusedByTwoServersIsInvalid) {
  Start([](const v1::PlayRequest&, v1::PlayReply*) { return true; });
  const std::string snapshot = Snapshot();
  ASSERT_THAT(Open({{0, 100, 1, snapshot}, {1, 100, 1, "no game"}, {2, 100, 1, snapshot}, {3, 100, 1, ""}}), IsOk());
  ASSERT_THAT(refused_, SizeIs(1));
  EXPECT_EQ(refused_[0].lane, 1);
  EXPECT_THAT(refused_[0].refusal, HasSubstr("snapshot"));
  EXPECT_THAT(Error(), IsOk());
  EXPECT_THAT(pool_->Step(pool_->Arrange({0, 2, 3}), std::vector<Action>(3, Action::kNoop), false), IsOk());
}

TEST_F(BadEnvServer, CancelEndsAWaitingCall) {
  Start([](const v1::PlayRequest& request, v1::PlayReply*) { return !request.has_step(); }, /*alone=*/true);
  ASSERT_THAT(OpenFour(), IsOk());
  absl::Status status;
  const absl::Time start = absl::Now();
  std::thread stepping([&] { status = StepFour(); });
  absl::SleepFor(absl::Milliseconds(100));  // most likely it is waiting now; if not, it is refused at once
  pool_->Cancel();
  stepping.join();
  EXPECT_LT(absl::Now() - start, kTimeout);
  EXPECT_TRUE(absl::IsCancelled(status)) << status;
  EXPECT_TRUE(absl::IsCancelled(OpenFour()));
}

TEST_F(BadEnvServer, AnExceptionIsATransientError) {
  const auto twist = [](const v1::PlayRequest& request, v1::PlayReply*) {
    if (request.has_open()) throw std::runtime_error("out of pixels");
    return true;
  };
  Start(twist, /*alone=*/true);
  const absl::Status status = OpenFour();
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kUnavailable, HasSubstr(server_->address())));
  EXPECT_TRUE(IsTransient(CallKind::kSession, status));
}

TEST(CanarylessEnvServer, IsRefusedIfACanaryIsRequired) {
  wire::EchoService service;  // its hello has no canary
  const auto server = *wire::Server::Create({"127.0.0.1:0"}, {&service});
  v1::SessionHello hello = SampleHello(50);
  EnvClient any(wire::Connect(server->address()), hello, kFrameBytes);
  EXPECT_THAT(any.Connect(absl::Seconds(20)), IsOk());
  hello.set_game_canary(std::string(kBuiltInGameCanary));
  EnvClient client(wire::Connect(server->address()), hello, kFrameBytes);
  EXPECT_THAT(client.Connect(absl::Seconds(20)),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr(server->address())));
  EXPECT_FALSE(client.connected());
}

}  // namespace
}  // namespace craftfleet
