// Simplex noise for many cells of a world at once: many times as fast as SimplexNoise::At, and inexact. A caller that
// compares it with a threshold asks SimplexNoise::At where the difference is within kNoiseError.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_NOISE_FIELD_H_
#define CRAFTFLEET_ENVSERVER_WORLD_NOISE_FIELD_H_

#include <absl/types/span.h>

#include "envserver/world/simplex_noise.h"

namespace craftfleet {

// Values differ from the exact ones by less than this. The field has all lattice points in reach. The exact noise
// leaves out one of them in some places, where its attenuation is at most 1/6, so its contribution at most 1.26e-4:
// 1/6^4 by the lengths of a gradient, sqrt(153), and of the displacement, sqrt(2 - 1/6), divided by kNoiseNorm. That
// 1/6 was found by sampling, and the field's floats add less than 1e-5: hence a bound of three times the sum.
inline constexpr float kNoiseError = 4.2e-4F;

// The noise at cell (column, row) is that at (column * step_x, row * step_y, z); steps are 1/20..1.
struct NoiseGrid {
  double step_x;
  double step_y;
  double z;
};

// A field is computed in blocks of so many rows; its last block may go beyond the world's height.
inline constexpr int kFieldBlock = 8;

// Columns from `begin` to before `end`, which is at most 256.
struct ColumnRange {
  int begin = 0;
  int end = 0;
};

// Adds weight * noise to `field`, float[columns][stride], where stride is a multiple of kFieldBlock: of each block of
// rows, in its columns.
void AddNoise(const SimplexNoise& noise, const NoiseGrid& grid, double weight, absl::Span<const ColumnRange> blocks,
              int stride, float* field);

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_NOISE_FIELD_H_
