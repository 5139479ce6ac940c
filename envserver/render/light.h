// The light on the map's pixels: daylight, the night's noise, sleep. All three ignore the alpha of the pixels: it
// becomes 0. Results are exactly those of the original's double and float operations in their order.
//
// Noise, if daylight < 0.5: one uniform draw U for each pixel of the map, x in the outer loop; all three channels use
// it.
//   With m = 2 * (0.5 - daylight) * cover (vignette.h), a channel c becomes v = trunc((1 - m) * c + m * (32 + 95 * U)).
//   By day v = c.
// Darkness: L = (19595 R + 38470 G + 7471 B + 32768) >> 16 of the pixel with its noise. D = trunc(L + 0.4 * (v - L)) in
//   float32, each operation rounded. The result is trunc(daylight * c + (0.5 * (1 - daylight)) * (D + T)), where c is
//   the channel without noise and T is 0, 16 and 64 for red, green and blue.
// Sleep: H = L >> 1 of the result, and the pixel of a sleeping player becomes (H, H, H + 8).

#pragma once

#include <cstdint>

#include <absl/types/span.h>

#include "envserver/render/rough_night.h"
#include "envserver/render/textures.h"

namespace craftfleet {

// Below this daylight a picture has noise, drawn from the world's stream.
inline constexpr double kNoiseBelow = 0.5;

// For daylight of kNoiseBelow..1.
void LightByDay(double daylight, absl::Span<Pixel> pixels);

// A map by night. Equal sizes, whole blocks of kNightBlock; what is beyond the map may have any values.
struct NightPixels {
  absl::Span<const uint32_t> high, low;  // the noise: RandomStream::FillWords
  absl::Span<const double> cover;        // the vignette
  absl::Span<const float> float_cover;   // the same
  absl::Span<const Pixel> canvas;
  absl::Span<Pixel> lit;  // the result
};

// For daylight of 0..kNoiseBelow.
void LightByNight(double daylight, const NightPixels& map);

// Changes lit pixels to the sleeping player's view.
void LightAsleep(absl::Span<Pixel> pixels);

}  // namespace craftfleet
