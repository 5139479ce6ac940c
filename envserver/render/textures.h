// The textures as the PNG files have them: loaded once, shared by every renderer.
// Immutable after Load(): may be shared between threads.

#ifndef CRAFTFLEET_ENVSERVER_RENDER_TEXTURES_H_
#define CRAFTFLEET_ENVSERVER_RENDER_TEXTURES_H_

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

inline constexpr int kTextureSize = 16;  // pixels a side

// One pixel: red in the lowest byte, then green, blue, alpha.
using Pixel = uint32_t;

struct Texture {
  std::array<Pixel, kTextureSize * kTextureSize> pixels{};  // [y][x]; alpha 255 where the file has none
};

// The picture in `bytes`, the content of a file.
//   InvalidArgument: no picture, not 8-bit RGB or RGBA, or not 16x16; names `path`.
absl::StatusOr<Texture> DecodeTexture(std::string bytes, absl::string_view path);

class Textures {
 public:
  // Reads "<name>.png" of every sprite, item and digit from `folder`. Those of appearance variants may be missing: the
  // renderer that needs one says so.
  //   NotFound: a file is missing. InvalidArgument: a file is no picture, not 8-bit RGB or RGBA, or not 16x16. All name
  //   the file.
  static absl::StatusOr<std::shared_ptr<const Textures>> Load(const std::string& folder);

  // Null only for appearance variants whose file was missing.
  const Texture* Find(absl::string_view name) const;
  // The file that a texture is read from.
  std::string PathOf(absl::string_view name) const;

 private:
  std::string folder_;
  std::map<std::string, Texture, std::less<>> textures_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_RENDER_TEXTURES_H_
