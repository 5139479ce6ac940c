// The light on the map's pixels: daylight, the night's noise, sleep. All three work in place and ignore the alpha of
// the pixels: it becomes 0. Double and float operations in the original's order, so results are exact.
// Source: RULES.md, section 13.

#ifndef CRAFTFLEET_ENVSERVER_RENDER_LIGHT_H_
#define CRAFTFLEET_ENVSERVER_RENDER_LIGHT_H_

#include <absl/types/span.h>

#include "envserver/render/textures.h"

namespace craftfleet {

// Below this daylight a picture has noise, drawn from the world's stream.
inline constexpr double kNoiseBelow = 0.5;

// For daylight of kNoiseBelow..1.
void LightByDay(double daylight, absl::Span<Pixel> pixels);

// For daylight of 0..kNoiseBelow. `noise`: one uniform draw a pixel; `cover`: the vignette. Equal sizes.
void LightByNight(double daylight, absl::Span<const double> noise, absl::Span<const double> cover,
                  absl::Span<Pixel> pixels);

// Changes lit pixels to the sleeping player's view.
void LightAsleep(absl::Span<Pixel> pixels);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_RENDER_LIGHT_H_
