// The fast, inexact noise and the traits of terrain made from it, against the exact noise, on each CPU path.

#include "envserver/world/noise_field.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include <gtest/gtest.h>

#include "envserver/world/random_stream.h"
#include "envserver/world/terrain.h"
#include "tests/fakes/cpu_paths.h"

namespace craftfleet {
namespace {

class NoiseFields : public OnEachCpuPath {};
CRAFTFLEET_ON_EACH_CPU_PATH(NoiseFields);

TEST_P(NoiseFields, AreWithinTheirErrorOfTheExactNoise) {
  constexpr int kColumns = 10;  // of tiles: more than the field keeps points for
  constexpr int kRows = 9;
  RandomStream random(1);
  for (int round = 0; round < 40; ++round) {
    const SimplexNoise noise(random.Below(1u << 31));
    const double step_x = 0.05 + 0.95 * random.Uniform();
    const double step_y = 0.05 + 0.95 * random.Uniform();
    const double z = random.Below(9);
    std::vector<uint32_t> wanted(kRows);
    for (uint32_t& columns : wanted) columns = random.Below(1u << kColumns);
    struct alignas(64) Tile {
      float cells[kTileSize][kTileSize];
    };
    std::vector<Tile> tiles(kRows * kColumns);
    for (Tile& tile : tiles) std::fill_n(tile.cells[0], kTileCells, 0.5F);
    NoiseField(step_x, step_y, z).Add(noise, 0.25, kColumns, wanted, tiles[0].cells[0]);
    for (int column = 0; column < kColumns * kTileSize; ++column) {
      for (int row = 0; row < kRows * kTileSize; ++row) {
        const bool is_wanted = (wanted[row / kTileSize] >> column / kTileSize & 1) != 0;
        const double exact = is_wanted ? noise.At(column * step_x, row * step_y, z) : 0;
        const Tile& tile = tiles[row / kTileSize * kColumns + column / kTileSize];
        ASSERT_LT(std::abs((tile.cells[column % kTileSize][row % kTileSize] - 0.5) / 0.25 - exact), kNoiseError)
            << round << ": " << column << ", " << row;
      }
    }
  }
}

class Terrain : public OnEachCpuPath {};
CRAFTFLEET_ON_EACH_CPU_PATH(Terrain);

TEST_P(Terrain, HasTheTraitsOfTheExactNoiseInEveryCell) {
  RandomStream random(2);
  for (int round = 0; round < 60; ++round) {
    const SimplexNoise noise(random.Below(1u << 31));
    const bool usual = round % 2 == 0;
    const int width = usual ? 64 : 4 + static_cast<int>(random.Below(150));
    const int height = usual ? 64 : 4 + static_cast<int>(random.Below(150));
    const Position player = {width / 2, height / 2};
    std::vector<uint16_t> traits(width * height);
    ComputeTraits(noise, width, height, player, absl::MakeSpan(traits));
    for (int x = 0; x < width; ++x) {
      for (int y = 0; y < height; ++y) {
        ASSERT_EQ(traits[x * height + y], ExactTraits(noise, {x, y}, player)) << round << ": " << x << ", " << y;
      }
    }
  }
}

}  // namespace
}  // namespace craftfleet
