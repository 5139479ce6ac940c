// Pictures of a recording: as RGB bytes, and what is drawn over them.

#ifndef CRAFTFLEET_ACTOR_RECORDING_PICTURE_H_
#define CRAFTFLEET_ACTOR_RECORDING_PICTURE_H_

#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>
#include <opencv2/core/mat.hpp>

namespace craftfleet {

// A picture uint8[S,S,3] under where an agent looks: `brightness`, float[F*F] in 0..1, of the frame that the picture
// shows larger (see BrightnessOfPixels). What is not looked at is dark and grey, what is looked at shines.
std::string OverlayAttention(absl::string_view picture, int picture_size, absl::Span<const float> brightness,
                             int frame_size);

// Two pictures of the same size, uint8[S,S,3], side by side: uint8[S,2*S,3].
std::string SideBySide(absl::string_view left, absl::string_view right, int picture_size);

// uint8[height,width,3] in the order of channels that OpenCV writes.
//   throws cv::Exception: no memory.
cv::Mat ToBgr(absl::string_view picture, int width, int height);

// Writes uint8[height,width,3] as a PNG file.
absl::Status WritePng(const std::string& path, absl::string_view picture, int width, int height);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_RECORDING_PICTURE_H_
