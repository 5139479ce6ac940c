// Simplex noise for many cells of a world at once: many times as fast as SimplexNoise::At, and inexact. A caller that
// compares it with a threshold asks SimplexNoise::At where the difference is within kNoiseError.

#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <absl/types/span.h>

#include "envserver/world/simplex_noise.h"

namespace craftfleet {

// Values differ from the exact ones by less than this. The field has all lattice points in reach. The exact noise
// leaves out one of them in some places, where its attenuation is at most 1/6, so its contribution at most 1.26e-4:
// 1/6^4 by the lengths of a gradient, sqrt(153), and of the displacement, sqrt(2 - 1/6), divided by kNoiseNorm. That
// 1/6 was found by sampling, and the field's floats add less than 1e-5: hence a bound of three times the sum.
inline constexpr float kNoiseError = 4.2e-4F;

// A field is stored in tiles of so many cells each way: float[tile rows][tile columns][kTileSize][kTileSize], the last
// index down. The last tiles may go beyond the world.
inline constexpr int kTileSize = 8;
inline constexpr int kTileCells = kTileSize * kTileSize;

// The noise at cell (column, row) is that at (column * step_x, row * step_y, z); steps are 1/20..1. Immutable after
// construction: may be shared between threads.
class NoiseField {
 public:
  NoiseField(double step_x, double step_y, double z);

  // Adds weight * noise to `values`, a field of `tile_columns`, 1..32, by wanted.size() tiles, in the wanted tiles. Bit
  // c of wanted[r]: the tile in column c and row r. `values` is aligned to 64 bytes.
  void Add(const SimplexNoise& noise, double weight, int tile_columns, absl::Span<const uint32_t> wanted,
           float* values) const;

  // A lattice point in reach of a tile.
  struct Point {
    float x, y;           // from the tile's first cell
    float z;              // from the point to the grid's plane
    float squared_reach;  // in the plane
    uint8_t i, j, k;      // the lowest bits of its numbers, on which its gradient depends
  };

 private:
  std::vector<Point> PointsOf(int column, int row) const;

  const double step_x_;
  const double step_y_;
  const double z_;
  // Of the tiles of a usual world, 8x8: they are the same for each seed. Other tiles' are found when they are needed.
  static constexpr int kKept = 8;
  std::array<std::vector<Point>, kKept * kKept> points_;  // [row][column]
};

}  // namespace craftfleet
