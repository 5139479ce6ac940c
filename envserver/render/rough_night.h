// The light by night in floats, without the low words of the noise: twice as fast as the exact light, and the same
// nearly everywhere. Only light.cc needs it.

#pragma once

#include <cstdint>

#include "envserver/render/textures.h"

namespace craftfleet {

// Pixels are lit in blocks of so many.
inline constexpr int kNightBlock = 32;

// Words of `unsure` for `blocks` blocks: a bit for each pixel, and a word for each place in a block, so that vectors of
// words need not be taken apart.
inline constexpr int kBlocksPerGroup = 32;
constexpr int UnsureWords(int blocks) { return (blocks + kBlocksPerGroup - 1) / kBlocksPerGroup * kNightBlock; }
// The pixel of a bit.
constexpr int PixelOfBit(int word, int bit) {
  return (word / kNightBlock * kBlocksPerGroup + bit) * kNightBlock + word % kNightBlock;
}

// Lit values that are whole, or at least so far from whole numbers, are right in floats.
inline constexpr double kFarFromWhole = 1e-4;

// Lights `blocks` blocks of `canvas` into `lit`, without alpha. `high`: the high words of the noise; `cover`: the
// vignette. `lit_is_sure`: at this daylight all lit values are whole or kFarFromWhole away. The bits of
// unsure[UnsureWords(blocks)] say which pixels may be wrong.
void LightRoughly(double daylight, bool lit_is_sure, const uint32_t* high, const float* cover, const Pixel* canvas,
                  int blocks, Pixel* lit, uint32_t* unsure);

}  // namespace craftfleet
