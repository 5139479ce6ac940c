#include "envserver/env_service.h"

#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/known_canary.h"
#include "tests/envserver/test_session.h"
#include "tests/fakes/played_game.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::AllOf;
using testing::HasSubstr;

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
                       AllOf(HasSubstr("plays another game"), HasSubstr("its canary is not 0123456789abcdef"))));
}

// The session and its other games continue.
TEST_F(EnvServiceTest, OnlyTheLaneWithAnInvalidSnapshotIsRefused) {
  Session session(server());
  ASSERT_THAT(session.Send(Hello("run-a")), IsOk());
  const auto witness = session.Send(Open(0, 5));
  ASSERT_THAT(witness, IsOk());
  for (const std::string& snapshot : {std::string(9000, 'x'), PlayedGame(MakeRenderer(kLength + 1), 1).game.Save()}) {
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
  EXPECT_EQ(Metric(*service_, "env_steps"), 2);
  session.Leave();
}

}  // namespace
}  // namespace craftfleet
