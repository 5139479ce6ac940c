// The pictures of a recording, as RGB bytes, and the attention drawn over them.

#pragma once

#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>
#include <opencv2/core/mat.hpp>

#include "common/agent/attention_map.h"

namespace craftfleet {

// Attention weights as brightness, with the scale of that brightness.
struct AttentionLight {
  std::vector<float> brightness;  // float[F*F] of a frame, 0..1
  double middle = 0;              // the weight at brightness 0.5
  double highest = 0;             // the weight at brightness 1 and above
};

// Brightness up to the frame's own highest weight: its square root, so that small weights are visible.
// `weights` is float[grid.count()].
AttentionLight LightToHighest(const PatchGrid& grid, absl::Span<const float> weights);

// A picture uint8[S,S,3] with an agent's attention drawn over it: `brightness`, float[F*F] in 0..1, belongs to the
// frame that the picture shows enlarged. Parts without attention are grey; parts with attention are highlighted.
std::string OverlayAttention(absl::string_view picture, int picture_size, absl::Span<const float> brightness,
                             int frame_size);

// "0%", "0.052%", "12%", "190%": two digits below 100%.
std::string PercentText(double part);

// Height of the strip below the pictures of BesideOverlay, pixels; even.
int ScaleHeight(int picture_size);

// A picture uint8[S,S,3] with its overlay on the right and a strip below that shows the scale of `light` as a colour
// bar, in percent: uint8[S+ScaleHeight(S),2*S,3].
std::string BesideOverlay(const std::string& picture, const std::string& overlay, int picture_size,
                          const AttentionLight& light);

// uint8[height,width,3] with the channels in OpenCV's order.
//   throws cv::Exception: no memory.
cv::Mat ToBgr(absl::string_view picture, int width, int height);

// Writes uint8[height,width,3] as a PNG file.
absl::Status WritePng(const std::string& path, absl::string_view picture, int width, int height);

}  // namespace craftfleet
