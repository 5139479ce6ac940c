// A digest of a set of textures, computed without decoding them. Two processes with equal digests draw the same.

#pragma once

#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

namespace craftfleet {

struct TextureFile {
  absl::string_view name;  // with ".png"
  absl::string_view bytes;
};

// 16 hex digits: 64-bit FNV-1a over name, a zero byte, and the bytes of each file, in the order given: by name.
std::string TextureDigest(absl::Span<const TextureFile> files);

// The digest of all *.png in `folder`.
//   NotFound: no such folder, or no *.png in it. Other errors as ReadFile(). All name the path.
absl::StatusOr<std::string> TextureDigest(const std::string& folder);

// Whether this program, whose textures have the digest `here`, draws as `run` ("the run in DIR") was `played`.
//   FailedPrecondition: it does not; says what to do.
absl::Status CheckTextureDigest(absl::string_view run, absl::string_view played, absl::string_view here);

}  // namespace craftfleet
