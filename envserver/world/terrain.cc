#include "envserver/world/terrain.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <absl/container/fixed_array.h>

#include "common/base/cpu_path.h"
#include "envserver/world/noise_field.h"

namespace craftfleet {
namespace {

constexpr int kSmallField = 64 * 64;  // cells; memory for larger fields comes from the heap

// Of a cell that is too near to a threshold of the step at hand; no cell has it in the end.
constexpr int32_t kUnsure = 1 << 16;

// The noise n(x * x_times / x_divided, y * y_times / y_divided, z, size) of a cell (x, y), as generation.h writes it.
struct Shape {
  double z;
  double size;
  double x_times = 1;
  double x_divided = 1;
  double y_times = 1;
  double y_divided = 1;

  // As Crafter computes it: the last bit counts.
  double At(const SimplexNoise& noise, Position p) const {
    return noise.At(p.x * x_times / x_divided / size, p.y * y_times / y_divided / size, z);
  }
  NoiseField field() const { return {x_times / x_divided / size, y_times / y_divided / size, z}; }
};
constexpr Shape kStartShape = {8, 3};
constexpr Shape kWaterShape = {3, 15};
constexpr Shape kFineWaterShape = {3, 5};
constexpr Shape kMountainShape = {0, 15};
constexpr Shape kFineMountainShape = {0, 5};

// A trait that cells with all of the traits `of`, and none of `not_of`, have where a layer is above the threshold.
struct LayerTrait {
  Shape shape;
  double threshold;
  uint16_t of;
  uint16_t not_of;
  Trait trait;

  bool AppliesTo(int32_t traits) const { return (traits & (of | not_of)) == of; }
};
constexpr int kNumLayerTraits = 8;
// Ordered so that the traits in `of` and `not_of` are known when a rule needs them.
constexpr LayerTrait kLayerTraits[kNumLayerTraits] = {
    {{6, 7}, 0.15, kPeak, 0, kCave},
    {{7, 3, 2, 1, 1, 5}, 0.4, kMountain, kCave, kTunnel},
    {{7, 3, 1, 5, 2, 1}, 0.4, kMountain, kCave | kTunnel, kTunnel},
    {{1, 8}, 0, kMountain, kCave | kTunnel, kCoalVein},
    {{2, 6}, 0.4, kMountain, kCave | kTunnel, kIronVein},
    {{6, 5}, 0.35, kPeak, kCave | kTunnel, kLavaField},
    {{4, 9}, -0.2, kShore, kStart | kMountain, kSandy},
    {{5, 7}, 0, 0, kStart | kMountain | kSandy | kSea, kForest},
};

// The fields of all shapes, shared by all worlds.
struct NoiseFields {
  NoiseField start = kStartShape.field();
  NoiseField water = kWaterShape.field();
  NoiseField fine_water = kFineWaterShape.field();
  NoiseField mountain = kMountainShape.field();
  NoiseField fine_mountain = kFineMountainShape.field();
  std::vector<NoiseField> layers;  // of kLayerTraits

  NoiseFields() {
    for (const LayerTrait& rule : kLayerTraits) layers.push_back(rule.shape.field());
  }
};
const NoiseFields& Fields() {
  static const NoiseFields fields;
  return fields;
}

double SquaredDistance(Position a, Position b) {
  const double dx = a.x - b.x;
  const double dy = a.y - b.y;
  return dx * dx + dy * dy;
}

// The traits that follow from the heights alone: `start`, water and mountain with all their parts.
uint16_t BaseTraits(double start, double water, double mountain) {
  if (start > 0.5) return kStart;
  if (mountain > 0.15) return kMountain | (mountain > 0.18 ? kHigh : 0) | (mountain > 0.3 ? kPeak : 0);
  return (water > 0.3 ? kSea : 0) | (water > 0.25 && water <= 0.35 ? kShore : 0);
}

uint16_t ExactBaseTraits(const SimplexNoise& noise, Position p, Position player) {
  const double start = 1 / (1 + std::exp(-(4 - std::sqrt(SquaredDistance(p, player)) + 2 * kStartShape.At(noise, p))));
  const double water = kWaterShape.At(noise, p) + 0.15 * kFineWaterShape.At(noise, p) + 0.1 - 2 * start;
  const double mountain =
      (kMountainShape.At(noise, p) + 0.3 * kFineMountainShape.At(noise, p)) / 1.3 - (4 * start + 0.3 * water);
  return BaseTraits(start, water, mountain);
}

// A cell farther than this from the player has start < most_far_start: its noise is not needed.
constexpr int kFar = 16;

// How much the heights of a cell may differ from the exact ones: by the error of their noise and of start. A logistic
// function's slope is at most 1/4.
constexpr float kNearStartError = 2 * kNoiseError / 4 + 1e-6F;
constexpr float WaterError(float start_error) { return 1.15F * kNoiseError + 2 * start_error + 1e-6F; }
constexpr float MountainError(float start_error) {
  return kNoiseError + 4 * start_error + 0.3F * WaterError(start_error) + 1e-6F;
}

bool Within(float value, float threshold, float error) { return std::abs(value - threshold) <= error; }

// Traits of `count` cells by their heights (without the part of start), with kUnsure near a threshold that matters.
CRAFTFLEET_KERNEL_BODY void CompareHeightsLoop(const float* start, const float* start_error, const float* waters,
                                               const float* mountains, int count, int32_t* traits) {
  for (int n = 0; n < count; ++n) {
    const float water = waters[n] + 0.1F - 2 * start[n];
    const float mountain = mountains[n] - (4 * start[n] + 0.3F * water);
    const float water_error = WaterError(start_error[n]);
    const float mountain_error = MountainError(start_error[n]);
    int32_t mountain_traits = kMountain;
    mountain_traits |= mountain > 0.18F ? kHigh : 0;
    mountain_traits |= mountain > 0.3F ? kPeak : 0;
    mountain_traits |= Within(mountain, 0.18F, mountain_error) ? kUnsure : 0;
    mountain_traits |= Within(mountain, 0.3F, mountain_error) ? kUnsure : 0;
    int32_t water_traits = water > 0.3F ? kSea : 0;
    water_traits |= (water > 0.25F ? kShore : 0) & (water <= 0.35F ? kShore : 0);
    water_traits |= Within(water, 0.25F, water_error) ? kUnsure : 0;
    water_traits |= Within(water, 0.3F, water_error) ? kUnsure : 0;
    water_traits |= Within(water, 0.35F, water_error) ? kUnsure : 0;
    int32_t sum = mountain > 0.15F ? mountain_traits : water_traits;
    sum |= Within(mountain, 0.15F, mountain_error) ? kUnsure : 0;
    sum = start[n] > 0.5F ? int32_t{kStart} : sum;
    traits[n] = sum | (Within(start[n], 0.5F, start_error[n]) ? kUnsure : 0);
  }
}
CRAFTFLEET_KERNEL(CompareHeights, CompareHeightsLoop)

// Gives the trait of a rule to the cells to which the rule applies, with kUnsure near the threshold.
CRAFTFLEET_KERNEL_BODY void CompareLayerLoop(const LayerTrait* rule, const float* values, int count, int32_t* traits) {
  const auto threshold = static_cast<float>(rule->threshold);
  const int32_t mask = rule->of | rule->not_of;
  const int32_t of = rule->of;
  const int32_t trait = rule->trait;
  for (int n = 0; n < count; ++n) {
    int32_t more = values[n] > threshold ? trait : 0;
    more |= Within(values[n], threshold, kNoiseError) ? kUnsure : 0;
    traits[n] |= (traits[n] & mask) == of ? more : 0;
  }
}
CRAFTFLEET_KERNEL(CompareLayer, CompareLayerLoop)

// The tiles of a row of them that have a cell to which the rule applies, a bit each.
CRAFTFLEET_KERNEL_BODY void FindTilesLoop(const LayerTrait* rule, const int32_t* traits, int count, uint32_t* tiles) {
  const int32_t mask = rule->of | rule->not_of;
  const int32_t of = rule->of;
  uint32_t found = 0;
  for (int tile = 0; tile < count; ++tile, traits += kTileCells) {
    int32_t any = 0;
    for (int n = 0; n < kTileCells; ++n) any |= (traits[n] & mask) == of ? 1 : 0;
    found |= static_cast<uint32_t>(any) << tile;
  }
  *tiles = found;
}
CRAFTFLEET_KERNEL(FindTiles, FindTilesLoop)

class Terrain {
 public:
  Terrain(const SimplexNoise& noise, int width, int height, Position player)
      : noise_(noise),
        width_(width),
        height_(height),
        player_(player),
        tile_columns_(Tiles(width)),
        wanted_(Tiles(height)),
        num_tiles_(tile_columns_ * Tiles(height)),
        field_(num_tiles_),
        traits_(num_tiles_) {
    traits_.Fill(0);
  }

  void Compute(absl::Span<uint16_t> traits) {
    ComputeBase();
    for (int number = 0; number < kNumLayerTraits; ++number) AddTrait(number);
    for (int x = 0; x < width_; ++x) {
      uint16_t* out = &traits[x * height_];
      for (int y = 0; y < height_; y += kTileSize) {
        std::copy_n(&traits_[Index({x, y})], std::min(kTileSize, height_ - y), out + y);
      }
    }
  }

 private:
  // Aligned, so that no vector lies across two cache lines.
  template <typename T>
  struct alignas(64) Tile {
    T cells[kTileCells];
  };
  template <typename T>
  class Field {
   public:
    explicit Field(int tiles) : tiles_(tiles) {}
    int size() const { return static_cast<int>(tiles_.size()) * kTileCells; }
    T* data() { return tiles_.data()->cells; }
    void Fill(T value) { std::fill_n(data(), size(), value); }
    T& operator[](int n) { return data()[n]; }

   private:
    absl::FixedArray<Tile<T>, kSmallField / kTileCells> tiles_;
  };

  static int Tiles(int cells) { return (cells + kTileSize - 1) / kTileSize; }
  // In a field.
  int Index(Position p) const {
    const int column = p.y / kTileSize * tile_columns_ * kTileSize + p.x;
    return column * kTileSize + p.y % kTileSize;
  }
  Position PositionOf(int index) const {
    const int column = index / kTileSize;
    const int columns = tile_columns_ * kTileSize;
    return {column % columns, column / columns * kTileSize + index % kTileSize};
  }

  // Calls exact(position, traits) for the cells that are unsure.
  template <typename Exact>
  void Decide(const Exact& exact) {
    for (int tile = 0; tile < traits_.size(); tile += kTileCells) {
      int32_t any = 0;
      for (int n = 0; n < kTileCells; ++n) any |= traits_[tile + n];
      if ((any & kUnsure) == 0) continue;
      for (int n = 0; n < kTileCells; ++n) {
        if ((traits_[tile + n] & kUnsure) == 0) continue;
        const Position p = PositionOf(tile + n);
        if (p.x < width_ && p.y < height_) exact(p, &traits_[tile + n]);
      }
    }
  }

  void AddNoise(const NoiseField& noise, double weight, Field<float>* field) const {
    noise.Add(noise_, weight, tile_columns_, wanted_, field->data());
  }

  void ComputeBase() {
    Field<float> water(num_tiles_);
    Field<float> mountain(num_tiles_);
    Field<float> start(num_tiles_);
    Field<float> start_error(num_tiles_);
    water.Fill(0);
    mountain.Fill(0);
    std::fill(wanted_.begin(), wanted_.end(), (uint32_t{2} << (tile_columns_ - 1)) - 1);
    AddNoise(Fields().water, 1, &water);
    AddNoise(Fields().fine_water, 0.15, &water);
    AddNoise(Fields().mountain, 1 / 1.3, &mountain);
    AddNoise(Fields().fine_mountain, 0.3 / 1.3, &mountain);
    ComputeStart(&start, &start_error);
    CompareHeights(start.data(), start_error.data(), water.data(), mountain.data(), field_.size(), traits_.data());
    Decide([&](Position p, int32_t* traits) { *traits = ExactBaseTraits(noise_, p, player_); });
  }

  void ComputeStart(Field<float>* start, Field<float>* error) {
    const auto most_far_start = static_cast<float>(1 / (1 + std::exp(kFar - 4 - 2 * kNoiseBound)));
    start->Fill(most_far_start / 2);
    error->Fill(most_far_start / 2);
    const int first_x = std::max(0, player_.x - kFar);
    const int end_x = std::min(width_, player_.x + kFar + 1);
    const int first_y = std::max(0, player_.y - kFar);
    const int end_y = std::min(height_, player_.y + kFar + 1);
    std::fill(wanted_.begin(), wanted_.end(), 0);
    const uint32_t tiles = (uint32_t{2} << (end_x - 1) / kTileSize) - (uint32_t{1} << first_x / kTileSize);
    std::fill(wanted_.begin() + first_y / kTileSize, wanted_.begin() + Tiles(end_y), tiles);
    field_.Fill(0);
    AddNoise(Fields().start, 1, &field_);
    for (int x = first_x; x < end_x; ++x) {
      for (int y = first_y; y < end_y; ++y) {
        const auto squared_distance = static_cast<float>(SquaredDistance({x, y}, player_));
        if (squared_distance > kFar * kFar) continue;
        const int n = Index({x, y});
        (*start)[n] = 1 / (1 + std::exp(-(4 - std::sqrt(squared_distance) + 2 * field_[n])));
        (*error)[n] = kNearStartError;
      }
    }
  }

  void AddTrait(int number) {
    const LayerTrait& rule = kLayerTraits[number];
    for (size_t row = 0; row < wanted_.size(); ++row) {
      FindTiles(&rule, &traits_[row * tile_columns_ * kTileCells], tile_columns_, &wanted_[row]);
    }
    field_.Fill(0);
    AddNoise(Fields().layers[number], 1, &field_);
    CompareLayer(&rule, field_.data(), field_.size(), traits_.data());
    Decide([&](Position p, int32_t* traits) {
      *traits &= ~(kUnsure | rule.trait);
      if (rule.shape.At(noise_, p) > rule.threshold) *traits |= rule.trait;
    });
  }

  const SimplexNoise& noise_;
  const int width_;
  const int height_;
  const Position player_;
  const int tile_columns_;
  absl::FixedArray<uint32_t, 8> wanted_;  // by row of tiles: those in which noise is computed, a bit each
  const int num_tiles_;
  Field<float> field_;
  Field<int32_t> traits_;
};

}  // namespace

void ComputeTraits(const SimplexNoise& noise, int width, int height, Position player, absl::Span<uint16_t> traits) {
  Terrain(noise, width, height, player).Compute(traits);
}

uint16_t ExactTraits(const SimplexNoise& noise, Position cell, Position player) {
  uint16_t traits = ExactBaseTraits(noise, cell, player);
  for (const LayerTrait& rule : kLayerTraits) {
    if (rule.AppliesTo(traits) && rule.shape.At(noise, cell) > rule.threshold) traits |= rule.trait;
  }
  return traits;
}

}  // namespace craftfleet
