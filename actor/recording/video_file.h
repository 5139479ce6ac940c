// A video file that is written picture by picture.

#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// Owned by one thread. Without Finish, the destructor removes the file.
class VideoFile {
 public:
  static constexpr int kPicturesPerSecond = 15;

  // Begins an mp4 file in the folder of `path`, under a new name, in H.264 if OpenCV can write it, else in MPEG-4.
  // Width and height are even, pixels.
  //   InvalidArgument: `path` is a folder or a device.
  //   FailedPrecondition: OpenCV can write neither, or the build has no video support.
  //   Others: codes of common/io/files.h.
  static absl::StatusOr<std::unique_ptr<VideoFile>> Create(const std::string& path, int width, int height);
  ~VideoFile();
  VideoFile(const VideoFile&) = delete;
  VideoFile& operator=(const VideoFile&) = delete;

  // `picture` is uint8[height,width,3], RGB.   Internal: OpenCV failed.
  absl::Status Append(absl::string_view picture);

  // Ends the video and moves it to `path`. Called again after an error, it fails again.
  //   DataLoss: pictures are missing, since the disk is full; `path` is as before.   Others: as RenameSynced.
  absl::Status Finish(const std::string& path);

 private:
  struct Writer;

  VideoFile(std::string path, int width, int height);

  const std::string path_;  // while it is being written
  const int width_;
  const int height_;
  int64_t pictures_ = 0;
  std::unique_ptr<Writer> writer_;
};

}  // namespace craftfleet
