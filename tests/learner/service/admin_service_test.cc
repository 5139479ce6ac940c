#include "learner/service/admin_service.h"

#include <atomic>
#include <memory>
#include <string>
#include <thread>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/channel.h"
#include "common/wire/grpc_status.h"
#include "common/wire/server.h"
#include "tests/fakes/fake_clock.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"
#include "tests/learner/scheduling/test_registry.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

using Stub = v1::AdminService::Stub;

constexpr absl::Duration kLong = absl::Minutes(4);
constexpr absl::Duration kShort = absl::Milliseconds(300);
constexpr absl::Duration kDeadline = absl::Seconds(2);  // of calls that are expected to time out

// The service with its real parts, called by a client.
class AdminServiceTest : public testing::Test {
 protected:
  AdminServiceTest() {
    registry_.OpenIteration(/*last_fragment=*/1, /*policy_version=*/1);
    server_ = *wire::Server::Create({}, {&service_});
    stub_ = v1::AdminService::NewStub(server_->InProcess().channel);
  }

  template <typename Request, typename Reply>
  absl::StatusOr<Reply> Call(grpc::Status (Stub::*method)(grpc::ClientContext*, const Request&, Reply*),
                             const Request& request, absl::Duration timeout) {
    grpc::ClientContext context;
    wire::SetDeadline(&context, timeout);
    Reply reply;
    const grpc::Status status = (stub_.get()->*method)(&context, request, &reply);
    if (!status.ok()) return wire::FromGrpc(status, "learner");
    return reply;
  }
  absl::StatusOr<v1::CheckpointReply> Checkpoint(absl::Duration timeout = kLong) {
    return Call(&Stub::Checkpoint, v1::CheckpointRequest(), timeout);
  }
  absl::Status Pause(absl::Duration timeout = kLong) {
    return Call(&Stub::Pause, v1::PauseRequest(), timeout).status();
  }
  bool Resume() { return Call(&Stub::Resume, v1::ResumeRequest(), kLong).value().was_paused(); }
  absl::StatusOr<v1::DrainReply> Drain(const std::string& worker, absl::Duration timeout = kLong) {
    v1::DrainRequest request;
    request.set_worker(worker);
    return Call(&Stub::Drain, request, timeout);
  }
  // Expects `done` to be set only after `act`, possibly with a delay.
  static void ExpectDoneOnlyAfter(const std::atomic<bool>& done, const std::function<void()>& act) {
    EXPECT_FALSE(WaitUntil([&] { return done.load(); }, kShort));
    act();
    EXPECT_TRUE(WaitUntil([&] { return done.load(); }, kLong));
  }

  // Joins and takes permits for both lanes.
  std::vector<Permit> Play(const std::string& actor) {
    registry_.Join(actor, "address of " + actor);
    return Ask(actor, {});
  }
  std::vector<Permit> Ask(const std::string& actor, const std::vector<Permit>& active) {
    return registry_.GetPermits(actor, active, /*capacity=*/2, absl::ZeroDuration())->granted;
  }
  void Announce(const std::string& name, const std::string& address, int lanes) {
    EXPECT_THAT(registry_.Announce({}, name, address, lanes, {}), IsOk());
  }
  void Finish(const std::string& actor, const std::vector<Permit>& permits) {
    for (const Permit& permit : permits) ASSERT_THAT(registry_.Accept(actor, permit, {"after", {}}), IsOk());
  }

  FakeClock clock_;
  CheckpointRequests checkpoints_;
  TestRegistry registry_{{/*lanes=*/2}, std::vector<LaneRecord>(2), &clock_};
  std::atomic<int> stops_{0};
  Steering steering_{{&checkpoints_, &registry_, [this] { ++stops_; }}};
  AdminServiceImpl service_{&steering_};
  std::unique_ptr<Stub> stub_;
  std::unique_ptr<wire::Server> server_;  // last: its threads use all of the above
};

TEST_F(AdminServiceTest, CheckpointWaitsForTheTrainersAnswer) {
  std::atomic<bool> done{false};
  std::thread client([&] {
    EXPECT_EQ(Checkpoint()->iteration(), 12);
    done = true;
  });
  ExpectDoneOnlyAfter(done, [this] { checkpoints_.Answer(12); });
  client.join();
}

TEST_F(AdminServiceTest, AFailedCheckpointReturnsItsError) {
  std::thread trainer([this] {
    EXPECT_TRUE(WaitUntil([this] { return checkpoints_.pending(); }, kLong));
    checkpoints_.Answer(absl::ResourceExhaustedError("disk full"));
  });
  EXPECT_THAT(Checkpoint(), StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("disk full")));
  trainer.join();
}

// The client gets the learner's message; if its own deadline passed first, it would not.
TEST_F(AdminServiceTest, CheckpointAnswersBeforeTheClientGivesUp) {
  EXPECT_THAT(Checkpoint(kDeadline), StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("no checkpoint within")));
  checkpoints_.Close();
  EXPECT_THAT(Checkpoint(), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("training has ended")));
}

TEST_F(AdminServiceTest, PauseGrantsNothingAndWaitsForFragmentsInProgress) {
  const std::vector<Permit> permits = Play("a");
  ASSERT_EQ(permits.size(), 2u);
  std::atomic<bool> done{false};
  std::thread client([&] {
    EXPECT_THAT(Pause(), IsOk());
    done = true;
  });
  ExpectDoneOnlyAfter(done, [&] { Finish("a", permits); });
  client.join();
  EXPECT_TRUE(registry_.paused());
  registry_.OpenIteration(2, 2);
  EXPECT_THAT(Ask("a", {}), testing::IsEmpty());
}

TEST_F(AdminServiceTest, APauseStaysInEffectAfterItsDeadline) {
  Play("a");
  EXPECT_THAT(Pause(kDeadline), StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("paused, but some fragments")));
  EXPECT_TRUE(registry_.paused());
}

TEST_F(AdminServiceTest, ResumeEndsThePauseAndReportsWhetherThereWasOne) {
  EXPECT_FALSE(Resume());
  ASSERT_THAT(Pause(), IsOk());
  EXPECT_TRUE(Resume());
  EXPECT_FALSE(registry_.paused());
  EXPECT_FALSE(Resume());
  EXPECT_EQ(Play("a").size(), 2u);
}

TEST_F(AdminServiceTest, DrainingAnActorWaitsForItsFragmentsAndItsEvaluation) {
  const std::vector<Permit> permits = Play("a");
  registry_.AddEvaluation({1, 1000, 1, 1, false, std::make_shared<HostWeights>("weights")});
  TestRegistry::PermitRequest request = TestRegistry::RequestOf("a", permits, /*capacity=*/2);
  request.evaluates = true;
  const auto task = registry_.GetPermits(request)->evaluation;
  std::atomic<bool> done{false};
  std::thread client([&] {
    EXPECT_EQ(Drain("a")->role(), "actor");
    done = true;
  });
  ExpectDoneOnlyAfter(done, [&] {
    Finish("a", permits);
    EXPECT_FALSE(WaitUntil([&] { return done.load(); }, kShort)) << "it plays an evaluation";
    EXPECT_THAT(registry_.FinishEvaluation("a", task->id, std::vector<Episode>(1)), IsOk());
  });
  client.join();
  registry_.OpenIteration(2, 2);
  EXPECT_THAT(Ask("a", {}), testing::IsEmpty());
  EXPECT_EQ(Play("b").size(), 2u) << "other actors continue";
}

TEST_F(AdminServiceTest, AnActorWithWorkLeftStaysDraining) {
  const std::vector<Permit> permits = Play("a");
  EXPECT_THAT(Drain("a", kDeadline),
              StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("it gets no more permits or evaluations")));
  Finish("a", permits);
  EXPECT_TRUE(registry_.IsDrained("a"));
}

TEST_F(AdminServiceTest, DrainingAServerWaitsUntilItReportsNoGames) {
  Announce("s", "10.0.0.3:9", /*lanes=*/4);
  std::atomic<bool> done{false};
  std::thread client([&] {
    EXPECT_EQ(Drain("10.0.0.3:9")->role(), "envserver");
    done = true;
  });
  ExpectDoneOnlyAfter(done, [this] { Announce("s", "10.0.0.3:9", /*lanes=*/0); });
  client.join();
  ASSERT_EQ(registry_.Servers().size(), 1u);
  EXPECT_TRUE(registry_.Servers()[0].draining);
}

TEST_F(AdminServiceTest, AnUndrainedWorkerGetsWorkAgain) {
  registry_.Join("a", "10.0.0.1:7");
  Announce("s", "10.0.0.3:9", /*lanes=*/4);
  Announce("t", "10.0.0.4:9", /*lanes=*/4);
  const auto undrain = [this](const std::string& worker) {
    v1::UndrainRequest request;
    request.set_worker(worker);
    return Call(&Stub::Undrain, request, kLong);
  };
  EXPECT_THAT(Drain("a"), IsOk());
  EXPECT_THAT(Ask("a", {}), testing::IsEmpty());
  EXPECT_EQ(undrain("10.0.0.1:7")->role(), "actor");
  EXPECT_FALSE(registry_.IsDrained("a"));
  EXPECT_EQ(Ask("a", {}).size(), 2u);
  EXPECT_THAT(Drain("s", kDeadline), StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("--envservers=learner")));
  ASSERT_EQ(registry_.Servers().size(), 2u);
  EXPECT_TRUE(registry_.Servers()[0].draining) << "it gets no new games";
  EXPECT_FALSE(registry_.Servers()[1].draining);
  EXPECT_EQ(undrain("s")->role(), "envserver");
  EXPECT_FALSE(registry_.Servers()[0].draining);
  EXPECT_THAT(undrain("x"), StatusIs(absl::StatusCode::kNotFound, HasSubstr("there are: a, s, t")));
  EXPECT_THAT(undrain(""), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("worker is empty")));
}

TEST_F(AdminServiceTest, TheErrorForAnUnknownWorkerSaysHowToRegister) {
  EXPECT_THAT(Drain("x"), StatusIs(absl::StatusCode::kNotFound,
                                   AllOf(HasSubstr("no worker \"x\""), HasSubstr("register with --learner"))));
}

// Workers without an address have an empty one, so an empty name would match them.
TEST_F(AdminServiceTest, AnEmptyNameIsRefused) {
  registry_.Join("a", "");
  EXPECT_THAT(Drain(""), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("worker is empty")));
  EXPECT_FALSE(registry_.IsDrained("a"));
}

TEST_F(AdminServiceTest, StopStopsTheLearner) {
  EXPECT_THAT(Call(&Stub::Stop, v1::StopRequest(), kLong), IsOk());
  EXPECT_EQ(stops_, 1);
}

TEST_F(AdminServiceTest, ADisconnectedClientEndsTheWait) {
  Play("a");
  grpc::ClientContext context;
  v1::PauseReply reply;
  std::thread client([&] { EXPECT_EQ(stub_->Pause(&context, {}, &reply).error_code(), grpc::StatusCode::CANCELLED); });
  EXPECT_TRUE(WaitUntil([this] { return registry_.paused(); }));
  context.TryCancel();
  client.join();
  // If the call continued, the server's shutdown would wait for it.
  const absl::Time begin = absl::Now();
  server_.reset();
  EXPECT_LT(absl::Now() - begin, kLong);
}

TEST_F(AdminServiceTest, EveryCallIsLoggedWithItsClient) {
  registry_.Join("a", "10.0.0.1:7");
  testing::internal::CaptureStderr();
  ASSERT_THAT(Pause(), IsOk());
  Resume();
  ASSERT_THAT(Drain("a"), IsOk());
  ASSERT_THAT(Checkpoint(kDeadline), Not(IsOk()));
  ASSERT_THAT(Call(&Stub::Stop, v1::StopRequest(), kLong), IsOk());
  const std::string log = testing::internal::GetCapturedStderr();
  for (const char* call : {": pause", ": resume", ": drain a", ": checkpoint", ": stop"}) {
    EXPECT_THAT(log, testing::ContainsRegex(absl::StrCat("admin [^ ]+", call)));
  }
}

}  // namespace
}  // namespace craftfleet
