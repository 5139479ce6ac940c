#include "envserver/render/image.h"

#include "common/base/cpu_path.h"

namespace craftfleet {
namespace {

// Every operation rounds to float, as in the original.
Pixel BlendChannel(Pixel over, Pixel under, float alpha) {
  const float sum =
      alpha * (static_cast<int32_t>(over) / 255.0f) + (1.0f - alpha) * (static_cast<int32_t>(under) / 255.0f);
  return static_cast<int32_t>(255.0f * sum);
}

CRAFTFLEET_KERNEL_BODY void BlendPixelsBody(const Pixel* over, int count, Pixel* canvas) {
  for (int i = 0; i < count; ++i) {
    const Pixel top = over[i];
    const Pixel under = canvas[i];
    const float alpha = static_cast<int32_t>(top >> 24) / 255.0f;
    canvas[i] = BlendChannel(top & 255, under & 255, alpha) |
                BlendChannel(top >> 8 & 255, under >> 8 & 255, alpha) << 8 |
                BlendChannel(top >> 16 & 255, under >> 16 & 255, alpha) << 16;
  }
}
CRAFTFLEET_KERNEL(BlendPixels, BlendPixelsBody)

}  // namespace

std::vector<int> NearestIndices(int from, int to) {
  std::vector<int> indices(to);
  const double step = static_cast<double>(from) / to;
  double position = step * 0.5;
  for (int& index : indices) {
    index = static_cast<int>(position);
    position += step;
  }
  return indices;
}

Image Resize(const Texture& texture, int width, int height) {
  const std::vector<int> rows = NearestIndices(kTextureSize, height);
  Image image{width, height, {}};
  image.pixels.reserve(static_cast<size_t>(width) * height);
  for (const int x : NearestIndices(kTextureSize, width)) {
    for (const int y : rows) image.pixels.push_back(texture.pixels[y * kTextureSize + x]);
  }
  return image;
}

void Blend(absl::Span<const Pixel> over, absl::Span<Pixel> canvas) {
  BlendPixels(over.data(), static_cast<int>(canvas.size()), canvas.data());
}

}  // namespace craftfleet
