#include "envserver/env_service.h"

#include <sys/resource.h>

#include <functional>
#include <memory>
#include <ostream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/strings/str_split.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/clock.h"
#include "common/config/known_canary.h"
#include "common/io/paths.h"
#include "common/io/texture_digest.h"
#include "common/wire/grpc_status.h"
#include "common/wire/protocol.h"
#include "common/wire/server.h"
#include "envserver/game.h"
#include "tests/fakes/sanitizers.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/wait_until.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr int kLength = 60;  // of an episode

v1::PlayRequest Hello(const std::string& run_id) {
  v1::PlayRequest request;
  v1::SessionHello* hello = request.mutable_hello();
  hello->set_protocol_version(wire::kProtocolVersion);
  hello->set_run_id(run_id);
  hello->set_texture_digest(*TextureDigest(*DefaultTextureDir()));
  hello->mutable_env()->set_name("crafter");
  hello->mutable_env()->set_frame_size(64);
  hello->mutable_env()->set_length(kLength);
  hello->set_client("a test");
  return request;
}

v1::PlayRequest Open(int lane, int64_t seed, const std::string& snapshot = "") {
  v1::PlayRequest request;
  v1::OpenLanes::Lane* message = request.mutable_open()->add_lanes();
  message->set_lane(lane);
  message->set_seed(seed);
  message->set_snapshot(snapshot);
  return request;
}

v1::PlayRequest Step(const std::vector<int>& lanes, const std::string& actions, bool snapshot = false) {
  v1::PlayRequest request;
  request.mutable_step()->mutable_lanes()->Assign(lanes.begin(), lanes.end());
  request.mutable_step()->set_actions(actions);
  request.mutable_step()->set_snapshot(snapshot);
  return request;
}

// A session that may send anything.
class Session {
 public:
  explicit Session(const wire::Endpoint& server) : stub_(v1::EnvironmentService::NewStub(server.channel)) {
    wire::SetDeadline(&context_, absl::Seconds(60));
    stream_ = stub_->Play(&context_);
  }

  // The reply, or the status with which the server ended the session.
  absl::StatusOr<v1::PlayReply> Send(const v1::PlayRequest& request) {
    v1::PlayReply reply;
    if (stream_->Write(request) && stream_->Read(&reply)) return reply;
    const absl::Status end = wire::FromGrpc(stream_->Finish(), "server");
    return end.ok() ? absl::InternalError("the session ended without an error") : end;
  }
  void Leave() {
    stream_->WritesDone();
    EXPECT_TRUE(stream_->Finish().ok());
  }

 private:
  grpc::ClientContext context_;
  const std::unique_ptr<v1::EnvironmentService::Stub> stub_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::PlayRequest, v1::PlayReply>> stream_;
};

// A well-behaved session on lane 7, compared with the same game played without a server.
class Witness {
 public:
  explicit Witness(const wire::Endpoint& server)
      : session_(server), frame_(64 * 64 * 3, '\0'), game_(*Game::Create(MakeRenderer(), 77, Bytes())) {
    EXPECT_THAT(session_.Send(Hello("run-a")), IsOk());
    const auto opened = session_.Send(Open(7, 77));
    EXPECT_THAT(opened, IsOk());
    EXPECT_EQ(opened->frames(), frame_);
  }

  void PlayOn(int steps) {
    for (int i = 0; i < steps; ++i) {
      const int action = (++steps_ * 5) % kNumActions;
      const auto reply = session_.Send(Step({7}, std::string(1, static_cast<char>(action)), true));
      ASSERT_THAT(reply, IsOk());
      std::string last_frames;
      const Game::PlayedStep played = game_.StepAndAutoReset(static_cast<Action>(action), Bytes(), &last_frames);
      ASSERT_EQ(reply->frames(), frame_) << "step " << steps_;
      ASSERT_EQ(reply->last_frames(), last_frames);
      ASSERT_EQ(reply->rewards(0), static_cast<float>(played.outcome.reward));
      ASSERT_EQ(reply->ends()[0], static_cast<char>(played.outcome.end));
      ASSERT_EQ(reply->episodes_size(), played.episode.has_value() ? 1 : 0);
      if (played.episode.has_value()) {
        ASSERT_EQ(reply->episodes(0).length(), played.episode->length);
      }
      ASSERT_EQ(reply->snapshots(0), game_.Save());
    }
  }

 private:
  static std::shared_ptr<const Renderer> MakeRenderer() {
    WorldOptions world;
    world.length = kLength;
    return *Renderer::Create(**Textures::Load(*DefaultTextureDir()), world, RenderOptions());
  }
  absl::Span<uint8_t> Bytes() { return absl::MakeSpan(reinterpret_cast<uint8_t*>(frame_.data()), frame_.size()); }

  Session session_;
  std::string frame_;
  Game game_;
  int steps_ = 0;
};

class EnvServiceTest : public testing::Test {
 protected:
  EnvServiceTest()
      : service_(*EnvServiceImpl::Create(*DefaultTextureDir())), server_(*wire::Server::Create({}, {service_.get()})) {}

  wire::Endpoint server() { return server_->InProcess(); }
  v1::StatusReply Status() const {
    v1::StatusReply reply;
    service_->FillStatus(&reply);
    return reply;
  }

  const std::unique_ptr<EnvServiceImpl> service_;
  const std::unique_ptr<wire::Server> server_;
};

TEST_F(EnvServiceTest, ASessionHasTheFirstFormatThatTheServerKnows) {
  const auto format_of = [&](const v1::PlayRequest& hello) {
    const auto reply = Session(server_->InProcess()).Send(hello);
    EXPECT_THAT(reply, IsOk());
    return reply->frame_format();
  };
  v1::PlayRequest hello = Hello("run-a");
  EXPECT_EQ(format_of(hello), v1::FRAMES_RAW);
  for (const int unknown : {1000, -1}) hello.mutable_hello()->add_frame_formats(static_cast<v1::FrameFormat>(unknown));
  EXPECT_EQ(format_of(hello), v1::FRAMES_RAW);
  hello.mutable_hello()->add_frame_formats(v1::FRAMES_SCENE);
  EXPECT_EQ(format_of(hello), v1::FRAMES_SCENE);
  v1::PlayRequest any_textures = hello;
  any_textures.mutable_hello()->clear_texture_digest();
  EXPECT_EQ(format_of(any_textures), v1::FRAMES_RAW) << "the client may draw with others";
  v1::PlayRequest recording = hello;
  recording.mutable_hello()->mutable_recording();
  EXPECT_EQ(format_of(recording), v1::FRAMES_RAW);
}

TEST_F(EnvServiceTest, StepsReturnTheFramesOfTheGame) {
  Witness witness(server());
  witness.PlayOn(2 * kLength + 5);
}

TEST_F(EnvServiceTest, HelloReturnsVersionAndCanary) {
  Session session(server());
  const auto greeted = session.Send(Hello("run-a"));
  ASSERT_THAT(greeted, IsOk());
  EXPECT_FALSE(greeted->program_version().empty());
  EXPECT_TRUE(session.Send(Open(0, 1))->program_version().empty());
  session.Leave();
}

TEST_F(EnvServiceTest, ASessionWithAnotherGameCanaryIsRefused) {
  const auto greeted = Session(server()).Send(Hello("run-a"));
  ASSERT_THAT(greeted, IsOk());
  EXPECT_EQ(greeted->canary(), kBuiltInGameCanary);
  v1::PlayRequest hello = Hello("run-a");
  hello.mutable_hello()->set_game_canary(greeted->canary());
  EXPECT_THAT(Session(server()).Send(hello), IsOk());
  hello.mutable_hello()->set_game_canary("0123456789abcdef");
  EXPECT_THAT(Session(server()).Send(hello),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr("plays another game"), HasSubstr("want 0123456789abcdef"))));
}

// An idle session of another run used to keep out the actors of the run that the server is registered with.
TEST_F(EnvServiceTest, ARegisteredServerServesItsOwnRunWhateverOthersClaim) {
  Session squatter(server());
  ASSERT_THAT(squatter.Send(Hello("run-b")), IsOk());
  service_->SetRun("run-a");
  Session session(server());
  EXPECT_THAT(session.Send(Hello("run-a")), IsOk());
  EXPECT_THAT(Session(server()).Send(Hello("run-b")),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("serves run run-a")));
}

// It used to keep the room of its games for --idle_timeout, ten minutes.
TEST(EnvService, AnIdleSessionGivesWayToOneThatNeedsItsRoom) {
  EnvServiceImpl::Options options;
  options.budget.games = 1;
  options.budget.session_games = 1;
  options.gives_way = absl::ZeroDuration();
  const auto service = *EnvServiceImpl::Create(*DefaultTextureDir(), options);
  const auto server = *wire::Server::Create({}, {service.get()});
  Session idle(server->InProcess());
  ASSERT_THAT(idle.Send(Hello("run-a")), IsOk());
  ASSERT_THAT(idle.Send(Open(0, 1)), IsOk());
  EXPECT_TRUE(WaitUntil([&] {
    Session session(server->InProcess());
    return session.Send(Hello("run-a")).ok() && session.Send(Open(0, 1)).ok();
  }));
}

// Each session of a client that alternates between two runs used to be a line of the log.
TEST_F(EnvServiceTest, ChangesOfTheRunDoNotFillTheLog) {
  testing::internal::CaptureStderr();
  const absl::Time start = SteadyNow();
  for (int i = 0; i < 8; ++i) {
    Session session(server());
    EXPECT_THAT(session.Send(Hello(i % 2 == 0 ? "run-a" : "run-b")), IsOk());
    session.Leave();
  }
  const std::string log = testing::internal::GetCapturedStderr();
  const std::vector<std::string> parts = absl::StrSplit(log, "serves run");
  EXPECT_GT(parts.size(), 1) << log;
  EXPECT_LE(parts.size() - 1, 1 + (SteadyNow() - start) / absl::Seconds(10)) << log;
}

TEST_F(EnvServiceTest, ASnapshotContinuesInAnotherSession) {
  Session first(server());
  ASSERT_THAT(first.Send(Hello("run-a")), IsOk());
  ASSERT_THAT(first.Send(Open(0, 5)), IsOk());
  for (int i = 0; i < 20; ++i) ASSERT_THAT(first.Send(Step({0}, "\x02")), IsOk());
  const auto last = first.Send(Step({0}, "\x02", true));
  ASSERT_THAT(last, IsOk());
  Session second(server());
  ASSERT_THAT(second.Send(Hello("run-a")), IsOk());
  EXPECT_EQ(second.Send(Open(3, 0, last->snapshots(0)))->frames(), last->frames());
  EXPECT_EQ(second.Send(Step({3}, "\x05"))->frames(), first.Send(Step({0}, "\x05"))->frames());
}

std::string SnapshotOfAnotherLength() {
  WorldOptions world;
  world.length = kLength + 1;
  const auto renderer = *Renderer::Create(**Textures::Load(*DefaultTextureDir()), world, RenderOptions());
  std::vector<uint8_t> frame(renderer->frame_bytes());
  return Game::Create(renderer, 1, absl::MakeSpan(frame))->Save();
}

// The session and its other games continue.
TEST_F(EnvServiceTest, OnlyTheLaneWithAnInvalidSnapshotIsRefused) {
  Session session(server());
  ASSERT_THAT(session.Send(Hello("run-a")), IsOk());
  const auto witness = session.Send(Open(0, 5));
  ASSERT_THAT(witness, IsOk());
  for (const std::string& snapshot : {std::string(9000, 'x'), SnapshotOfAnotherLength()}) {
    v1::PlayRequest open = Open(1, 5);
    open.mutable_open()->MergeFrom(Open(2, 5, snapshot).open());
    const auto reply = session.Send(open);
    ASSERT_THAT(reply, IsOk());
    EXPECT_EQ(reply->frames(), witness->frames()) << "of lane 1 only";
    ASSERT_EQ(reply->refused_size(), 1);
    EXPECT_EQ(reply->refused(0).lane(), 2);
    EXPECT_THAT(reply->refused(0).reason(), HasSubstr("snapshot: "));
    EXPECT_LE(reply->refused(0).reason().size(), 300);
  }
  EXPECT_EQ(session.Send(Step({0, 1}, "\x05\x05"))->refused_size(), 0);
}

TEST_F(EnvServiceTest, ClosedLanesCannotBeStepped) {
  Session session(server());
  ASSERT_THAT(session.Send(Hello("run-a")), IsOk());
  ASSERT_THAT(session.Send(Open(4, 1)), IsOk());
  v1::PlayRequest close;
  close.mutable_close()->add_lanes(4);
  ASSERT_THAT(session.Send(close), IsOk());
  EXPECT_THAT(session.Send(Step({4}, "\x01")), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("lane 4")));
}

TEST_F(EnvServiceTest, StatusHasSessionsAndSteps) {
  Session session(server());
  ASSERT_THAT(session.Send(Hello("run-a")), IsOk());
  ASSERT_THAT(session.Send(Open(4, 1)), IsOk());
  ASSERT_THAT(session.Send(Step({4}, std::string(1, '\0'))), IsOk());
  ASSERT_THAT(session.Send(Step({4}, std::string(1, '\0'))), IsOk());
  const v1::StatusReply status = Status();
  EXPECT_EQ(status.run_id(), "run-a");
  ASSERT_EQ(status.peers_size(), 1);
  EXPECT_EQ(status.peers(0).name(), "a test");
  EXPECT_EQ(status.peers(0).state(), "1 lanes");
  for (const v1::Metric& metric : status.metrics()) {
    if (metric.name() == "env_steps") {
      EXPECT_EQ(metric.value(), 2);
    }
  }
  session.Leave();
}

// An exception ends only its session, with an error after which its fragments are played again. Here there is too
// little memory for the pictures of 4096 games.
TEST_F(EnvServiceTest, AnExceptionEndsOnlyItsSession) {
  if (kAddressSanitizer) GTEST_SKIP() << "AddressSanitizer needs address space without a limit";
  Witness witness(server());
  Session session(server());
  v1::PlayRequest hello = Hello("run-a");
  hello.mutable_hello()->mutable_env()->set_frame_size(1024);
  ASSERT_THAT(session.Send(hello), IsOk());
  v1::PlayRequest open;
  for (int lane = 0; lane < EnvBatch::kMaxLanes; ++lane) open.mutable_open()->add_lanes()->set_lane(lane);
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_AS, &before), 0);
  const rlimit limit = {4UL << 30, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_AS, &limit), 0);
  const absl::Status status = session.Send(open).status();
  ASSERT_EQ(setrlimit(RLIMIT_AS, &before), 0);
  EXPECT_THAT(status,
              StatusIs(absl::StatusCode::kAborted, AllOf(HasSubstr("the environment failed"), HasSubstr("bad_alloc"))));
  witness.PlayOn(10);
}

TEST_F(EnvServiceTest, AnotherRunIsRefusedUntilTheFirstHasLeft) {
  auto first = std::make_unique<Session>(server());
  ASSERT_THAT(first->Send(Hello("run-a")), IsOk());
  EXPECT_THAT(Session(server()).Send(Hello("run-b")),
              StatusIs(absl::StatusCode::kResourceExhausted, AllOf(HasSubstr("run-a"), HasSubstr("run-b"))));
  first->Leave();
  EXPECT_THAT(Session(server()).Send(Hello("run-b")), IsOk());
}

// An evaluation's session belongs to no run; it must not let two runs in.
TEST_F(EnvServiceTest, BesideASessionWithoutRunOneRunIsAdmitted) {
  Session evaluation(server());
  ASSERT_THAT(evaluation.Send(Hello("")), IsOk());
  Session first(server());
  ASSERT_THAT(first.Send(Hello("run-a")), IsOk());
  EXPECT_THAT(Session(server()).Send(Hello("run-b")),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("run-a")));
  EXPECT_THAT(Session(server()).Send(Hello("")), IsOk());
}

TEST_F(EnvServiceTest, OneOfTwoConcurrentRunsIsRefused) {
  for (int round = 0; round < 20; ++round) {
    Session a(server());
    Session b(server());
    absl::StatusOr<v1::PlayReply> answer_a;
    std::thread thread([&] { answer_a = a.Send(Hello("run-a")); });
    const absl::StatusOr<v1::PlayReply> answer_b = b.Send(Hello("run-b"));
    thread.join();
    EXPECT_NE(answer_a.ok(), answer_b.ok());
    (answer_a.ok() ? a : b).Leave();
  }
}

// Invalid clients: sends `requests` in order; the last one is answered by an error.
struct InvalidClient {
  std::string what;
  std::function<std::vector<v1::PlayRequest>()> requests;
  absl::StatusCode code;
  std::vector<std::string> message;
  friend void PrintTo(const InvalidClient& misdeed, std::ostream* out) { *out << misdeed.what; }
};

class InvalidClients : public EnvServiceTest, public testing::WithParamInterface<InvalidClient> {};

TEST_P(InvalidClients, EndTheirSessionAndNoOther) {
  Witness witness(server());
  witness.PlayOn(3);
  Session session(server());
  std::vector<v1::PlayRequest> requests = GetParam().requests();
  const v1::PlayRequest last = requests.back();
  requests.pop_back();
  for (const v1::PlayRequest& request : requests) ASSERT_THAT(session.Send(request), IsOk());
  const auto reply = session.Send(last);
  for (const std::string& part : GetParam().message) EXPECT_THAT(reply, StatusIs(GetParam().code, HasSubstr(part)));
  witness.PlayOn(3);
  EXPECT_EQ(Status().peers_size(), 1);
}

v1::PlayRequest HelloBut(const std::function<void(v1::SessionHello*)>& change) {
  v1::PlayRequest request = Hello("run-a");
  change(request.mutable_hello());
  return request;
}

const std::vector<InvalidClient>& AllInvalidClients() {
  using Requests = std::vector<v1::PlayRequest>;
  constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;
  constexpr auto kPrecondition = absl::StatusCode::kFailedPrecondition;
  static const auto* const misdeeds = new std::vector<InvalidClient>{
      {"NoHello", [] { return Requests{Open(0, 1)}; }, kInvalid, {"a session begins with hello"}},
      {"HelloTwice",
       [] {
         return Requests{Hello("run-a"), Hello("run-a")};
       },
       kInvalid,
       {"hello came twice"}},
      {"EmptyRequest",
       [] {
         return Requests{Hello("run-a"), {}};
       },
       kInvalid,
       {"want open, step or close"}},
      {"OlderProtocol",
       [] { return Requests{HelloBut([](auto* h) { h->set_protocol_version(0); })}; },
       kPrecondition,
       {"speaks protocol version 2, the actor 0", "upgrade the actor"}},
      {"OtherTextures",
       [] { return Requests{HelloBut([](auto* h) { h->set_texture_digest("0123456789abcdef"); })}; },
       kPrecondition,
       {"0123456789abcdef", "--textures"}},
      {"OtherRun",
       [] { return Requests{Hello("run-b")}; },
       absl::StatusCode::kResourceExhausted,  // the server is free again when that run ends
       {"serves run run-a", "belongs to run run-b"}},
      {"ClientOfManyWords",
       [] { return Requests{HelloBut([](auto* h) { h->set_client(std::string(513, 'a')); })}; },
       kInvalid,
       {"client has 513 bytes, want at most 512"}},
      {"RunThatCannotBePrinted",
       [] { return Requests{HelloBut([](auto* h) { h->set_run_id("run-a\n"); })}; },
       kInvalid,
       {"run_id is \"run-a\\n\", want printable ASCII"}},
      {"UnknownGame",
       [] { return Requests{HelloBut([](auto* h) { h->mutable_env()->set_name("pong"); })}; },
       kInvalid,
       {"environment \"pong\"", "want \"crafter\""}},
      {"UnknownOption",
       [] { return Requests{HelloBut([](auto* h) { h->mutable_env()->set_name("crafter:colour=red"); })}; },
       kInvalid,
       {"unknown option \"colour", "want one of"}},
      {"TinyFrames",
       [] { return Requests{HelloBut([](auto* h) { h->mutable_env()->set_frame_size(3); })}; },
       kInvalid,
       {"picture width 3, want "}},
      {"NegativeLength",
       [] { return Requests{HelloBut([](auto* h) { h->mutable_env()->set_length(-5); })}; },
       kInvalid,
       {"length -5, want "}},
      {"UnknownLane",
       [] {
         return Requests{Hello("run-a"), Open(0, 1), Step({0, 3}, "\x01\x01")};
       },
       kInvalid,
       {"lane 3 is not open"}},
      {"AnotherSessionsLane",
       [] {
         return Requests{Hello("run-a"), Step({7}, "\x01")};
       },
       kInvalid,
       {"lane 7 is not open in this session"}},
      {"LaneTwice",
       [] {
         return Requests{Hello("run-a"), Open(0, 1), Step({0, 0}, "\x01\x01")};
       },
       kInvalid,
       {"lane 0 is named twice"}},
      {"Action17",
       [] {
         return Requests{Hello("run-a"), Open(0, 1), Step({0}, "\x11")};
       },
       kInvalid,
       {"action 17 at 0, want 0..16"}},
      {"ActionMissing",
       [] {
         return Requests{Hello("run-a"), Open(0, 1), Step({0}, "")};
       },
       kInvalid,
       {"actions: 0 bytes, want 1"}},
      {"NegativeLane",
       [] {
         return Requests{Hello("run-a"), Open(-2, 1)};
       },
       kInvalid,
       {"lane -2, want at least 0"}},
  };
  return *misdeeds;
}

INSTANTIATE_TEST_SUITE_P(EnvService, InvalidClients, testing::ValuesIn(AllInvalidClients()),
                         [](const auto& info) { return info.param.what; });

TEST(EnvService, NamesAMissingTextureFolder) {
  EXPECT_THAT(EnvServiceImpl::Create("/no/such/folder"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("/no/such/folder")));
}

}  // namespace
}  // namespace craftfleet
