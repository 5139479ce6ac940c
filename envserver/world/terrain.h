// The traits of each cell of a new world that follow from the noise alone, before any draw. All cells are compared with
// the thresholds by their inexact noise (noise_field.h), those too near to a threshold again by their exact noise.
// Source: generation.h.

#pragma once

#include <cstdint>

#include <absl/types/span.h>

#include "envserver/world/simplex_noise.h"
#include "envserver/world/types.h"

namespace craftfleet {

// A cell's traits, one bit each.
enum Trait : uint16_t {
  kStart = 1 << 0,      // start > 0.5: the meadow around the player; such a cell has no other trait
  kMountain = 1 << 1,   // mountain > 0.15
  kHigh = 1 << 2,       // mountain > 0.18
  kPeak = 1 << 3,       // mountain > 0.3
  kCave = 1 << 4,       // of peaks: n(x, y, 6, 7) > 0.15
  kTunnel = 1 << 5,     // of mountains but caves: n(2x, y / 5, 7, 3) > 0.4 or n(x / 5, 2y, 7, 3) > 0.4
  kCoalVein = 1 << 6,   // of mountains but paths: n(x, y, 1, 8) > 0
  kIronVein = 1 << 7,   // of mountains but paths: n(x, y, 2, 6) > 0.4
  kLavaField = 1 << 8,  // of peaks but paths: n(x, y, 6, 5) > 0.35
  kShore = 1 << 9,      // of no mountains: 0.25 < water <= 0.35
  kSea = 1 << 10,       // of no mountains: 0.3 < water
  kSandy = 1 << 11,     // of shores but mountains: n(x, y, 4, 9) > -0.2
  kForest = 1 << 12,    // of the rest but the sea: n(x, y, 5, 7) > 0
};

// Writes `traits`, uint16[width][height], y fastest, for a world in which the player starts at `player`. Worlds of up
// to 64x64 cells need no memory from the heap.
void ComputeTraits(const SimplexNoise& noise, int width, int height, Position player, absl::Span<uint16_t> traits);

// What ComputeTraits is to give, cell by cell from exact noise, for tests.
uint16_t ExactTraits(const SimplexNoise& noise, Position cell, Position player);

}  // namespace craftfleet
