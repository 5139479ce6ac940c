// The light on the map's pixels: daylight, the night's noise, sleep. All three ignore the alpha of the pixels: it
// becomes 0. Results are exactly those of the original's double and float operations in their order.
// Source: RULES.md, section 13.

#ifndef CRAFTFLEET_ENVSERVER_RENDER_LIGHT_H_
#define CRAFTFLEET_ENVSERVER_RENDER_LIGHT_H_

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

#endif  // CRAFTFLEET_ENVSERVER_RENDER_LIGHT_H_
