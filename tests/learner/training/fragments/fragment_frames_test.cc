#include "learner/training/fragments/fragment_frames.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/config/config.h"
#include "common/io/texture_digest.h"
#include "envserver/game.h"
#include "envserver/render/textures.h"
#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr int kSteps = 500;  // with nights and deaths

class FragmentFramesTest : public testing::Test {
 protected:
  // Plays a fragment; `frames_` gets its pixels, `records_` the same as records.
  void SetUp() override {
    const auto renderer = *Renderer::Create(*Textures::BuiltIn(), WorldOptions(), RenderOptions());
    std::string frame(renderer->frame_bytes(), '\0');
    Game game = *Game::Create(renderer, 4, FrameBytes(&frame));
    game.Record(&records_);
    frames_ = frame;
    std::string last_frames;
    for (int step = 1; step < kSteps; ++step) {
      game.StepAndAutoReset(ActionAt(step), FrameBytes(&frame), &last_frames);
      frames_ += frame;
    }
    Game again = *Game::Create(renderer, 4, FrameBytes(&frame));
    for (int step = 1; step < kSteps; ++step) {
      again.StepAndRecord(ActionAt(step), /*anew=*/false, &records_, &last_frames);
    }
    ASSERT_THAT(last_frames, IsEmpty());
  }
  static Action ActionAt(int step) { return static_cast<Action>(step * 7 % kNumActions); }
  v1::FragmentMessage Message(const std::string& frames, v1::FrameFormat format) const {
    v1::FragmentMessage message;
    message.set_frames(frames);
    message.set_frame_format(format);
    return message;
  }
  static std::string Digest() { return TextureDigest(BuiltInTextures()); }

  static v1::RunConfig Config() {
    v1::RunConfig config = DefaultRunConfig();
    config.mutable_env()->set_frame_size(64);
    return config;
  }

  const v1::RunConfig config_ = Config();
  std::string frames_;
  std::string records_;
};

TEST_F(FragmentFramesTest, RecordsBecomeTheFramesThatAnotherActorSendsRaw) {
  const FragmentFrames frames(config_, Digest());
  v1::FragmentMessage raw = Message(frames_, v1::FRAMES_RAW);
  v1::FragmentMessage scenes = Message(records_, v1::FRAMES_SCENE);
  ASSERT_THAT(frames.Draw(kSteps, &raw), IsOk());
  ASSERT_THAT(frames.Draw(kSteps, &scenes), IsOk());
  EXPECT_TRUE(raw.frames() == frames_);
  EXPECT_TRUE(scenes.frames() == frames_);
  EXPECT_EQ(scenes.frame_format(), v1::FRAMES_RAW);
  EXPECT_LT(records_.size() / kSteps, 400);
}

TEST_F(FragmentFramesTest, TheNumberOfRecordsIsThatOfTheSteps) {
  const FragmentFrames frames(config_, Digest());
  for (const int steps : {kSteps - 1, kSteps + 1}) {
    v1::FragmentMessage scenes = Message(records_, v1::FRAMES_SCENE);
    EXPECT_THAT(frames.Draw(steps, &scenes), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("frames: ")));
  }
}

TEST_F(FragmentFramesTest, OtherFormatsAreRefused) {
  const FragmentFrames frames(config_, Digest());
  for (const int format : {1, 3, -1}) {
    v1::FragmentMessage message = Message(records_, static_cast<v1::FrameFormat>(format));
    EXPECT_THAT(frames.Draw(kSteps, &message),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("frame_format: " + std::to_string(format))));
  }
}

TEST_F(FragmentFramesTest, RecordsAreTakenOnlyWithTheTexturesOfThisProgram) {
  v1::JoinReply reply;
  FragmentFrames(config_, Digest()).AddFormats(&reply);
  EXPECT_THAT(reply.frame_formats(), ElementsAre(v1::FRAMES_SCENE));
  const FragmentFrames other_textures(config_, "0123456789abcdef");
  reply.Clear();
  other_textures.AddFormats(&reply);
  EXPECT_THAT(reply.frame_formats(), IsEmpty());
  v1::FragmentMessage scenes = Message(records_, v1::FRAMES_SCENE);
  EXPECT_THAT(other_textures.Draw(kSteps, &scenes),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("frame_format: 2")));
}

}  // namespace
}  // namespace craftfleet
