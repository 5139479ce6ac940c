#include "actor/recording/video_file.h"

#include <array>
#include <filesystem>
#include <system_error>
#include <utility>

#include <absl/strings/str_cat.h>
#include <opencv2/videoio.hpp>

#include "actor/recording/picture.h"
#include "common/base/check.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

// In order of preference; browsers can play the first.
constexpr std::array<const char*, 2> kCodecs = {"avc1", "mp4v"};

constexpr size_t kLeastBytes = 1 << 16;  // more than the shortest video has

// The pictures in a finished video; 0 if it is damaged.
int64_t CountPictures(const std::string& path) {
  try {
    cv::VideoCapture video(path, cv::CAP_FFMPEG);
    return video.isOpened() ? static_cast<int64_t>(video.get(cv::CAP_PROP_FRAME_COUNT)) : 0;
  } catch (const cv::Exception&) {
    return 0;
  }
}

// Checked before the pictures are made, because the finished video is renamed to `path`.
absl::Status CheckTarget(const std::string& path) {
  std::error_code error;
  const std::filesystem::file_status target = std::filesystem::status(path, error);
  if (!std::filesystem::exists(target) || std::filesystem::is_regular_file(target)) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(path, " is a folder or a device, want a file"));
}

}  // namespace

struct VideoFile::Writer {
  cv::VideoWriter video;
};

VideoFile::VideoFile(std::string path, int width, int height)
    : path_(std::move(path)), width_(width), height_(height), writer_(std::make_unique<Writer>()) {}

VideoFile::~VideoFile() {
  if (writer_ == nullptr) return;
  writer_->video.release();
  RemoveAll(path_).IgnoreError();
}

absl::StatusOr<std::unique_ptr<VideoFile>> VideoFile::Create(const std::string& path, int width, int height) {
  CRAFTFLEET_CHECK(width > 0 && height > 0 && width % 2 == 0 && height % 2 == 0);
  CRAFTFLEET_RETURN_IF_ERROR(CheckTarget(path));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string unfinished, CreateBeside(path, ".mp4"));
  std::unique_ptr<VideoFile> video(new VideoFile(unfinished, width, height));
  // Tried first, because OpenCV does not report why it can't write a file.
  CRAFTFLEET_RETURN_IF_ERROR(WriteFileSynced(unfinished, std::string(kLeastBytes, '\0')));
  for (const char* codec : kCodecs) {
    try {
      const int code = cv::VideoWriter::fourcc(codec[0], codec[1], codec[2], codec[3]);
      if (video->writer_->video.open(unfinished, cv::CAP_FFMPEG, code, kPicturesPerSecond, cv::Size(width, height)))
        return video;
    } catch (const cv::Exception& error) {
      return absl::InternalError(absl::StrCat(path, ": ", error.what()));
    }
  }
  return absl::FailedPreconditionError(
      absl::StrCat(path, ": OpenCV can write neither H.264 nor MPEG-4 video: install an OpenCV with FFmpeg"));
}

absl::Status VideoFile::Append(absl::string_view picture) {
  try {
    writer_->video.write(ToBgr(picture, width_, height_));
  } catch (const cv::Exception& error) {
    return absl::InternalError(absl::StrCat(path_, ": ", error.what()));
  }
  ++pictures_;
  return absl::OkStatus();
}

absl::Status VideoFile::Finish(const std::string& path) {
  writer_->video.release();
  // OpenCV does not report that it could not write.
  const int64_t written = CountPictures(path_);
  if (written != pictures_) {
    return absl::DataLossError(absl::StrCat("cannot write ", path, ": it has ", written, " of ", pictures_,
                                            " pictures: free space on that disk"));
  }
  CRAFTFLEET_RETURN_IF_ERROR(RenameSynced(path_, path));
  writer_ = nullptr;  // nothing to remove
  return absl::OkStatus();
}

}  // namespace craftfleet
