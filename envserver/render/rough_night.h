// The light by night in floats, without the low words of the noise: twice as fast as the exact light, and the same
// nearly everywhere. Only light.cc needs it.

#ifndef CRAFTFLEET_ENVSERVER_RENDER_ROUGH_NIGHT_H_
#define CRAFTFLEET_ENVSERVER_RENDER_ROUGH_NIGHT_H_

#include <cstdint>

#include "envserver/render/textures.h"

namespace craftfleet {

// Pixels are lit in blocks of so many.
inline constexpr int kNightBlock = 32;

// Lights `blocks` blocks of `canvas` into `lit`, without alpha. `high`: the high words of the noise; `cover`: the
// vignette. Bit n of unsure[b] says that pixel n of block b may be wrong.
void LightRoughly(double daylight, const uint32_t* high, const float* cover, const Pixel* canvas, int blocks,
                  Pixel* lit, uint32_t* unsure);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_RENDER_ROUGH_NIGHT_H_
