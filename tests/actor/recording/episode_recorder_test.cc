#include "actor/recording/episode_recorder.h"

#include <memory>
#include <string>
#include <vector>

#include <absl/time/clock.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>

#include "common/agent/policy.h"
#include "common/io/files.h"
#include "tests/fakes/sample_policy.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

constexpr int kFrameSize = 8;
constexpr int kPictureSize = 64;

// A moment `step` steps into an episode, one achievement more every other step.
Moment MomentAt(int step) {
  Moment moment;
  moment.frame.assign(size_t{3} * kFrameSize * kFrameSize, static_cast<char>(step + 1));
  moment.picture.assign(size_t{3} * kPictureSize * kPictureSize, static_cast<char>(20 * step));
  moment.semantic.assign(size_t{kWorldSize} * kWorldSize, '\2');
  moment.semantic[3 * kWorldSize + step] = 13;
  moment.player_x = 3;
  moment.player_y = step;
  moment.inventory.fill(9);
  for (int i = 0; i < step / 2; ++i) moment.achievements[i] = step;
  return moment;
}

EpisodeRecorder::AttentionSource AttentionOf(const Policy& policy) {
  return [&policy](absl::string_view frame) { return policy.Attention(frame); };
}

class EpisodeRecorderTest : public testing::Test {
 protected:
  EpisodeRecorderTest() {
    options_.frame_size = kFrameSize;
    options_.picture_size = kPictureSize;
    options_.first_episode = 5;
  }

  std::unique_ptr<EpisodeRecorder> Make() const {
    const absl::Time start = absl::FromCivil(absl::CivilSecond(2024, 2, 29, 23, 59, 58), absl::UTCTimeZone());
    auto recorder = EpisodeRecorder::Create(options_, nullptr, start);
    EXPECT_THAT(recorder, IsOk());
    return *std::move(recorder);
  }
  static void Play(int64_t number, int steps, EpisodeRecorder* recorder, StepEnd end = StepEnd::kTerminated) {
    ASSERT_THAT(recorder->OnStart(number, MomentAt(0)), IsOk());
    for (int step = 1; step <= steps; ++step) {
      const ObservedStep observed = {Action::kSleep, step == 2 ? 0.9F : -0.1F, step == steps ? end : StepEnd::kNone};
      ASSERT_THAT(recorder->OnStep(number, observed, MomentAt(step)), IsOk());
    }
  }
  std::vector<std::string> Files(const std::string& folder) const { return *ListFolder(folder_ / folder); }

  const TempFolder folder_;
  EpisodeRecorder::Options options_;
};

TEST_F(EpisodeRecorderTest, NamesFilesByTimeEpisodeAchievementsAndLength) {
  options_.video_folder = folder_ / "video";
  options_.npz_folder = folder_ / "npz";
  const auto recorder = Make();
  Play(7, 4, recorder.get());
  Play(5, 3, recorder.get());
  EXPECT_THAT(Files("video"),
              ElementsAre("20240229T235958-episode0005-ach1-len3.mp4", "20240301T000000-episode0007-ach2-len4.mp4"));
  EXPECT_THAT(Files("npz"),
              ElementsAre("20240229T235958-episode0005-ach1-len3.npz", "20240301T000000-episode0007-ach2-len4.npz"));
}

TEST_F(EpisodeRecorderTest, NeverOverwritesAFile) {
  options_.npz_folder = folder_ / "npz";
  for (int i = 0; i < 3; ++i) Play(5, 3, Make().get());
  EXPECT_THAT(Files("npz"),
              ElementsAre("20240229T235958-episode0005-ach1-len3.npz", "20240229T235959-episode0005-ach1-len3.npz",
                          "20240301T000000-episode0005-ach1-len3.npz"));
}

TEST_F(EpisodeRecorderTest, ConcurrentEpisodesDoNotMix) {
  options_.video_folder = folder_ / "video";
  const auto recorder = Make();
  ASSERT_THAT(recorder->OnStart(5, MomentAt(0)), IsOk());
  Play(6, 2, recorder.get());
  for (int step = 1; step <= 5; ++step) {
    ASSERT_THAT(recorder->OnStep(5, {Action::kDo, 0, step == 5 ? StepEnd::kTruncated : StepEnd::kNone}, MomentAt(step)),
                IsOk());
  }
  ASSERT_THAT(Files("video"),
              ElementsAre("20240229T235958-episode0005-ach2-len5.mp4", "20240229T235959-episode0006-ach1-len2.mp4"));
  cv::VideoCapture video(folder_ / "video/20240229T235958-episode0005-ach2-len5.mp4");
  cv::Mat picture;
  int pictures = 0;
  for (; video.read(picture); ++pictures) {
    EXPECT_NEAR(picture.at<cv::Vec3b>(10, 10)[1], 20 * pictures, 6);
  }
  EXPECT_EQ(pictures, 6) << "the reset and five steps";
  EXPECT_EQ(picture.cols, 0);
}

TEST_F(EpisodeRecorderTest, AnAbortedEvaluationLeavesNoPartialVideo) {
  options_.video_folder = folder_ / "video";
  auto recorder = Make();
  ASSERT_THAT(recorder->OnStart(5, MomentAt(0)), IsOk());
  recorder = nullptr;
  EXPECT_THAT(Files("video"), IsEmpty());
}

TEST_F(EpisodeRecorderTest, KeepsUnfinishedEpisodesIfAsked) {
  options_.video_folder = folder_ / "video";
  options_.npz_folder = folder_ / "episodes";
  auto recorder = Make();
  Play(5, 4, recorder.get(), StepEnd::kNone);
  ASSERT_THAT(recorder->FinishAll(), IsOk());
  EXPECT_THAT(Files("video"), ElementsAre("20240229T235958-episode0005-ach2-len4.mp4"));
  EXPECT_THAT(Files("episodes"), ElementsAre("20240229T235958-episode0005-ach2-len4.npz"));
}

TEST_F(EpisodeRecorderTest, AnEpisodeWhoseVideoFailsIsNotWrittenAgain) {
  options_.video_folder = folder_ / "video";
  options_.npz_folder = folder_ / "npz";
  const auto recorder = Make();
  Play(5, 4, recorder.get(), StepEnd::kNone);
  ASSERT_THAT(RemoveAll(folder_ / ("video/" + Files("video")[0])), IsOk()) << "the unfinished video";
  EXPECT_THAT(recorder->FinishAll(), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("0 of 5 pictures")));
  EXPECT_THAT(recorder->FinishAll(), IsOk());
  EXPECT_THAT(Files("video"), IsEmpty());
  EXPECT_THAT(Files("npz"), SizeIs(1));
}

TEST_F(EpisodeRecorderTest, ShowsAttentionWithItsScaleOnTheRightOfPicturesAndVideos) {
  const auto policy = SamplePolicy(1, 1, "oc_ca");
  options_.frame_size = 72;
  options_.attention = AttentionChoice();
  options_.picture_folder = folder_ / "pictures";
  options_.video_folder = folder_ / "video";
  auto recorder = EpisodeRecorder::Create(options_, AttentionOf(*policy), absl::Now());
  ASSERT_THAT(recorder, IsOk());
  Moment moment = MomentAt(5);
  moment.frame.assign(size_t{3} * 72 * 72, '\1');
  ASSERT_THAT((*recorder)->OnStart(5, moment), IsOk());
  ASSERT_THAT((*recorder)->OnStep(5, {Action::kDo, 0, StepEnd::kTerminated}, moment), IsOk());
  cv::Mat picture = cv::imread(folder_ / "pictures/episode-0005-step-00000.png");
  ASSERT_EQ(picture.cols, 2 * kPictureSize);
  ASSERT_EQ(picture.rows, kPictureSize + ScaleHeight(kPictureSize));
  EXPECT_EQ(picture.at<cv::Vec3b>(32, kPictureSize - 1), (cv::Vec3b{100, 100, 100})) << "the unchanged picture";
  const auto overlaid = picture.at<cv::Vec3b>(32, kPictureSize + 10);
  EXPECT_GT(overlaid[2], overlaid[0]) << "light is more red than blue";
  const auto unseen = picture.at<cv::Vec3b>(32, 2 * kPictureSize - 1);
  EXPECT_EQ(unseen, (cv::Vec3b{70, 70, 70})) << "only 64 of 72 pixels are covered by patches";

  ASSERT_EQ(Files("video").size(), 1U);
  cv::VideoCapture video(folder_ / ("video/" + Files("video")[0]));
  ASSERT_TRUE(video.read(picture));
  EXPECT_EQ(picture.cols, 2 * kPictureSize);
  EXPECT_EQ(picture.rows, kPictureSize + ScaleHeight(kPictureSize));
}

}  // namespace
}  // namespace craftfleet
