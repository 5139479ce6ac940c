#include "actor/frame_reader.h"

#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "actor/env_client.h"
#include "common/io/texture_digest.h"
#include "envserver/render/built_in_renderer.h"
#include "tests/fakes/env_server.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace frame_reader_test {

using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

constexpr int kFrameBytes = 64 * 64 * 3;
constexpr int kSteps = 180;  // of an episode, whose last steps are at night

v1::SessionHello RawHello() {
  v1::SessionHello hello = SampleHello(kSteps);
  hello.set_texture_digest(*TextureDigest(*DefaultTextureDir()));
  return hello;
}

v1::SessionHello SceneHello() {
  v1::SessionHello hello = RawHello();
  hello.add_frame_formats(v1::FRAMES_SCENE);
  return hello;
}

// Sessions with the same games: one has raw frames, one has records.
TEST(FrameReader, ASessionWithRecordsHasTheFramesOfARawOne) {
  const EnvServer server;
  EnvClient raw(server.Connect(), RawHello(), kFrameBytes);
  EnvClient scenes(server.Connect(), SceneHello(), kFrameBytes);
  const std::vector<EnvClient::Lane> lanes = {{3, 3, 1, ""}, {1, 1, 1, ""}};
  std::string raw_frames;
  std::string frames;
  for (EnvClient* client : {&raw, &scenes}) ASSERT_THAT(client->Connect(absl::Seconds(20)), IsOk());
  ASSERT_THAT(raw.Open(lanes, &raw_frames), IsOk());
  ASSERT_THAT(scenes.Open(lanes, &frames), IsOk());
  EXPECT_TRUE(frames == raw_frames);
  EXPECT_THAT(scenes.records(), SizeIs(2));
  EXPECT_THAT(raw.records(), IsEmpty());
  StepBatch of_raw;
  StepBatch of_scenes;
  int truncated = 0;
  for (int i = 0; i < 3 * kSteps; ++i) {
    const std::vector<Action> actions = {static_cast<Action>(i % kNumActions), Action::kNoop};
    const bool snapshot = i % 32 == 31;
    ASSERT_THAT(raw.SendStep({3, 1}, actions, snapshot), IsOk());
    ASSERT_THAT(scenes.SendStep({3, 1}, actions, snapshot), IsOk());
    ASSERT_THAT(raw.ReceiveStep(&of_raw), IsOk());
    ASSERT_THAT(scenes.ReceiveStep(&of_scenes), IsOk());
    ASSERT_TRUE(of_scenes.frames == of_raw.frames) << i;
    ASSERT_TRUE(of_scenes.last_frames == of_raw.last_frames) << i;
    ASSERT_TRUE(of_scenes.snapshots == of_raw.snapshots) << i;
    ASSERT_THAT(scenes.records(), SizeIs(2));
    truncated += of_raw.last_frames.empty() ? 0 : 1;
  }
  EXPECT_GT(truncated, 0);
}

class FrameReplies : public testing::Test {
 protected:
  void SetUp() override {
    renderer_ = *BuiltInRenderer("crafter", 64);  // which the readers share
    const World world = *World::Create(WorldOptions(), 1);
    Scene scene;
    renderer_->Capture(world, &scene);
    SceneWriter().Append(*renderer_, scene, world.random(), &day_);
    scene.daylight = 0.25;
    SceneWriter writer;
    writer.Append(*renderer_, scene, world.random(), &night_);
    RandomStream later = world.random();
    later.Skip(renderer_->noise_words());
    writer.Append(*renderer_, scene, later, &next_night_);
  }
  // The error of a reply to a step of `lanes` lanes, in a new session.
  static absl::Status Step(int lanes, const std::string& frames, const std::string& last_frames,
                           const std::string& ends) {
    FrameReader reader(SceneHello(), kFrameBytes);
    v1::PlayReply hello;
    hello.set_frame_format(v1::FRAMES_SCENE);
    if (absl::Status status = reader.Begin(hello); !status.ok()) return status;
    v1::StepLanes request;
    for (int lane = 0; lane < lanes; ++lane) request.add_lanes(lane);
    v1::PlayReply reply;
    reply.set_frames(frames);
    reply.set_last_frames(last_frames);
    reply.set_ends(ends);
    std::vector<std::string> records;
    absl::Status status = reader.ReadStep(request, &reply, &records);
    if (status.ok()) {
      EXPECT_EQ(reply.frames().size(), size_t{kFrameBytes} * lanes);
      EXPECT_THAT(records, SizeIs(lanes));
    }
    return status;
  }

  std::shared_ptr<const Renderer> renderer_;
  std::string day_;
  std::string night_;
  std::string next_night_;
};

TEST_F(FrameReplies, RecordsMatchTheRowsOfTheRequest) {
  const std::string running(2, '\0');
  EXPECT_THAT(Step(2, day_ + night_, "", running), IsOk());
  EXPECT_THAT(Step(2, day_, "", running), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("frames: ")));
  EXPECT_THAT(Step(2, day_ + day_ + day_, "", running),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("after the last record")));
  EXPECT_THAT(Step(2, day_ + day_, day_, running),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("last_frames: ")));
  EXPECT_THAT(Step(2, day_ + day_, "", std::string("\0\2", 2)),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("last_frames: ")));
  EXPECT_THAT(Step(2, day_ + day_, day_, std::string("\0\2", 2)), IsOk());
  EXPECT_THAT(Step(2, day_ + day_, "", "\0"), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("ends: ")));
}

TEST_F(FrameReplies, TheLastFrameOfALaneComesBeforeItsNext) {
  const std::string truncated(1, '\2');
  EXPECT_THAT(Step(1, next_night_, night_, truncated), IsOk());
  EXPECT_THAT(Step(1, night_, next_night_, truncated),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("noise without a stream")));
  // Each lane has a stream of its own.
  EXPECT_THAT(Step(2, night_ + next_night_, "", std::string(2, '\0')),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("noise without a stream")));
}

TEST_F(FrameReplies, AFormatThatWasNotAskedForIsRefused) {
  FrameReader raw(RawHello(), kFrameBytes);
  FrameReader scenes(SceneHello(), kFrameBytes);
  v1::PlayReply hello;
  EXPECT_THAT(raw.Begin(hello), IsOk());
  EXPECT_THAT(scenes.Begin(hello), IsOk());
  hello.set_frame_format(v1::FRAMES_SCENE);
  EXPECT_THAT(scenes.Begin(hello), IsOk());
  EXPECT_THAT(raw.Begin(hello), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("frame_format 2")));
  hello.set_frame_format(static_cast<v1::FrameFormat>(1));
  EXPECT_THAT(scenes.Begin(hello), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("frame_format 1")));
  hello.set_frame_format(static_cast<v1::FrameFormat>(77));
  EXPECT_THAT(scenes.Begin(hello), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("frame_format 77")));
}

}  // namespace frame_reader_test
}  // namespace craftfleet
