// Resizes textures and draws one over another.

#pragma once

#include <vector>

#include <absl/types/span.h>

#include "envserver/render/textures.h"

namespace craftfleet {

// Stored column by column, the order in which the map's noise is drawn from the stream.
struct Image {
  int width = 0;
  int height = 0;
  std::vector<Pixel> pixels;  // [width][height]

  Pixel at(int x, int y) const { return pixels[x * height + y]; }
};

// For each of `to` pixels the pixel of `from` that it shows: trunc(p), where p starts at (from / to) * 0.5 and from /
// to is added for each further pixel. The sum, as in the original: the product would select other pixels at some sizes.
std::vector<int> NearestIndices(int from, int to);

Image Resize(const Texture& texture, int width, int height);

// Draws each pixel of `over` by its alpha onto the pixel of `canvas` in the same place. Equal sizes. A channel, in
// float32, with alpha a, colour t and canvas c divided by 255: trunc(255 * (a * t + (1 - a) * c)).
void Blend(absl::Span<const Pixel> over, absl::Span<Pixel> canvas);

}  // namespace craftfleet
