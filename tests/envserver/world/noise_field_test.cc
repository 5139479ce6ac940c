// The fast, inexact noise and the traits of terrain made from it, against the exact noise, on each CPU path.

#include "envserver/world/noise_field.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "envserver/world/random_stream.h"
#include "envserver/world/terrain.h"
#include "tests/fakes/cpu_paths.h"

namespace craftfleet {
namespace {

class NoiseField : public OnEachCpuPath {};
CRAFTFLEET_ON_EACH_CPU_PATH(NoiseField);

TEST_P(NoiseField, IsWithinItsErrorOfTheExactNoise) {
  constexpr int kColumns = 60;
  constexpr int kRows = 64;
  RandomStream random(1);
  for (int round = 0; round < 40; ++round) {
    const SimplexNoise noise(random.Below(1u << 31));
    const NoiseGrid grid = {0.05 + 0.95 * random.Uniform(), 0.05 + 0.95 * random.Uniform(),
                            static_cast<double>(random.Below(9))};
    std::vector<ColumnRange> blocks(kRows / kFieldBlock);
    for (ColumnRange& columns : blocks) {
      columns.begin = static_cast<int>(random.Below(kColumns));
      columns.end = static_cast<int>(random.Below(kColumns + 1));  // may be empty
    }
    std::vector<float> field(kColumns * kRows, 0.5F);
    AddNoise(noise, grid, 0.25, blocks, kRows, field.data());
    for (int column = 0; column < kColumns; ++column) {
      for (int row = 0; row < kRows; ++row) {
        const ColumnRange columns = blocks[row / kFieldBlock];
        const bool wanted = column >= columns.begin && column < columns.end;
        const double exact = wanted ? noise.At(column * grid.step_x, row * grid.step_y, grid.z) : 0;
        ASSERT_LT(std::abs((field[column * kRows + row] - 0.5) / 0.25 - exact), kNoiseError)
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
