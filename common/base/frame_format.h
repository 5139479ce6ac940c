// The names of the formats of frames, as flags have them.

#ifndef CRAFTFLEET_COMMON_BASE_FRAME_FORMAT_H_
#define CRAFTFLEET_COMMON_BASE_FRAME_FORMAT_H_

#include <array>
#include <optional>

#include <absl/strings/string_view.h>

#include "common/base/types.h"

namespace craftfleet {

constexpr std::array<FrameFormat, 2> kFrameFormats = {FrameFormat::kRaw, FrameFormat::kScene};

// "raw" or "scene".
constexpr const char* FrameFormatName(FrameFormat format) { return format == FrameFormat::kRaw ? "raw" : "scene"; }

// The format of that name; nullopt: there is none.
inline std::optional<FrameFormat> FindFrameFormat(absl::string_view name) {
  for (const FrameFormat format : kFrameFormats) {
    if (name == FrameFormatName(format)) return format;
  }
  return std::nullopt;
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_BASE_FRAME_FORMAT_H_
