// Pictures as PNG files, by libpng alone: OpenCV's codecs would bring a hundred libraries with them.

#pragma once

#include <string>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// A PNG file, 8 bits a channel. `pixels` is uint8[height,width,3], RGB; compressed fast rather than small.
//   InvalidArgument: the size is not that of `pixels`, or one side is below 1 or above a million pixels (libpng's
//   limit).   Internal: no memory.
// Thread-safe.
absl::StatusOr<std::string> EncodePng(absl::string_view pixels, int width, int height);

}  // namespace craftfleet
