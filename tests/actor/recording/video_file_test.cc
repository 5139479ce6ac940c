#include "actor/recording/video_file.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/videoio.hpp>

#include "common/io/files.h"
#include "tests/fakes/status_matchers.h"
#include "tests/fakes/temp_folder.h"

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr int kWidth = 96;
constexpr int kHeight = 64;

std::string Plain(int red, int green, int blue) {
  std::string picture;
  for (int i = 0; i < kWidth * kHeight; ++i) {
    for (const int c : {red, green, blue}) picture.push_back(static_cast<char>(c));
  }
  return picture;
}

TEST(VideoFile, ContainsTheAppendedPictures) {
  const TempFolder folder;
  auto video = VideoFile::Create(folder / "unfinished.mp4", kWidth, kHeight);
  ASSERT_THAT(video, IsOk());
  for (int i = 0; i < 10; ++i) ASSERT_THAT((*video)->Append(i < 5 ? Plain(200, 30, 40) : Plain(10, 20, 230)), IsOk());
  ASSERT_THAT((*video)->Finish(folder / "video.mp4"), IsOk());
  EXPECT_THAT(*ListFolder(folder / ""), ElementsAre("video.mp4"));

  cv::VideoCapture read(folder / "video.mp4");
  EXPECT_EQ(read.get(cv::CAP_PROP_FRAME_WIDTH), kWidth);
  EXPECT_EQ(read.get(cv::CAP_PROP_FRAME_HEIGHT), kHeight);
  EXPECT_EQ(read.get(cv::CAP_PROP_FPS), VideoFile::kPicturesPerSecond);
  cv::Mat picture;
  int pictures = 0;
  for (; read.read(picture); ++pictures) {
    const auto pixel = picture.at<cv::Vec3b>(kHeight / 2, kWidth / 2);
    EXPECT_NEAR(pixel[2], pictures < 5 ? 200 : 10, 20) << "red of picture " << pictures;
    EXPECT_NEAR(pixel[0], pictures < 5 ? 40 : 230, 20) << "blue of picture " << pictures;
  }
  EXPECT_EQ(pictures, 10);
}

TEST(VideoFile, AnUnfinishedVideoLeavesNoFile) {
  const TempFolder folder;
  auto video = VideoFile::Create(folder / "unfinished.mp4", kWidth, kHeight);
  ASSERT_THAT(video, IsOk());
  ASSERT_THAT((*video)->Append(Plain(1, 2, 3)), IsOk());
  video->reset();
  EXPECT_THAT(*ListFolder(folder / ""), IsEmpty());
}

TEST(VideoFile, NamesTheFileThatCannotBeWritten) {
  const TempFolder folder;
  EXPECT_THAT(VideoFile::Create(folder / "none/a.mp4", kWidth, kHeight),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("none/a.mp4")));
}

TEST(VideoFile, AFolderIsRefusedBeforeTheFirstPicture) {
  const TempFolder folder;
  ASSERT_THAT(CreateFolders(folder / "a.mp4"), IsOk());
  EXPECT_THAT(VideoFile::Create(folder / "a.mp4", kWidth, kHeight),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("a.mp4 is a folder or a device, want a file")));
  EXPECT_THAT(*ListFolder(folder / ""), ElementsAre("a.mp4"));
}

TEST(VideoFile, AVideoThatCannotBeRenamedLeavesNoFile) {
  const TempFolder folder;
  auto video = VideoFile::Create(folder / "a.mp4", kWidth, kHeight);
  ASSERT_THAT(video, IsOk());
  ASSERT_THAT((*video)->Append(Plain(1, 2, 3)), IsOk());
  ASSERT_THAT(CreateFolders(folder / "a.mp4"), IsOk());
  for (int i = 0; i < 2; ++i) EXPECT_THAT((*video)->Finish(folder / "a.mp4"), Not(IsOk()));
  video->reset();
  EXPECT_THAT(*ListFolder(folder / ""), ElementsAre("a.mp4"));
}

}  // namespace
}  // namespace craftfleet
