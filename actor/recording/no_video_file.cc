// Replaces video_file.cc in builds with CRAFTFLEET_WITH_VIDEO=OFF: every video is refused.

#include <absl/strings/str_cat.h>

#include "actor/recording/video_file.h"

namespace craftfleet {

struct VideoFile::Writer {};

VideoFile::~VideoFile() = default;

absl::StatusOr<std::unique_ptr<VideoFile>> VideoFile::Create(const std::string& path, int /*width*/, int /*height*/) {
  return absl::FailedPreconditionError(absl::StrCat(
      path, ": this build has no video support (CRAFTFLEET_WITH_VIDEO=OFF); --episodes_npz stores the pictures"));
}

absl::Status VideoFile::Append(absl::string_view /*picture*/) { return absl::InternalError("there is no video"); }

absl::Status VideoFile::Finish(const std::string& /*path*/) { return absl::InternalError("there is no video"); }

}  // namespace craftfleet
