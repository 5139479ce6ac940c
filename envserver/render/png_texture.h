// One texture file and its pixels: the only part of the renderer that uses libpng. Thread-safe.

#pragma once

#include <array>
#include <cstdint>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

inline constexpr int kTextureSize = 16;  // pixels a side

// One pixel: red in the lowest byte, then green, blue, alpha.
using Pixel = uint32_t;

struct Texture {
  std::array<Pixel, kTextureSize * kTextureSize> pixels{};  // [y][x]; alpha 255 where the file has none
};

// Decodes `bytes`, the content of a PNG file: 16x16 pixels, 8-bit RGB or RGBA. A palette, or grey with alpha, is
// converted to those. Colours are taken as stored, without regard to a gamma or colour profile. Bytes after the end of
// the image are ignored.
//   InvalidArgument: not a complete PNG, or of another size, depth or number of channels; names `path`.
absl::StatusOr<Texture> DecodeTexture(absl::string_view bytes, absl::string_view path);

}  // namespace craftfleet
