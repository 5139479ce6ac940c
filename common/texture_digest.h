// Tells whether two processes draw with the same textures, without decoding a picture.

#ifndef CRAFTFLEET_COMMON_TEXTURE_DIGEST_H_
#define CRAFTFLEET_COMMON_TEXTURE_DIGEST_H_

#include <string>

#include <absl/status/statusor.h>

namespace craftfleet {

// 16 hex digits: 64-bit FNV-1a over name, a zero byte, and the file's bytes of each *.png in `folder`, sorted by name.
//   NotFound: no such folder, or no *.png in it. Other codes as ReadFile() gives them; all name the path.
absl::StatusOr<std::string> TextureDigest(const std::string& folder);

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_TEXTURE_DIGEST_H_
