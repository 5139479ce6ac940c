#include "envserver/world/terrain.h"

#include <algorithm>
#include <cmath>

#include <absl/container/fixed_array.h>

#include "common/base/cpu_path.h"
#include "envserver/world/noise_field.h"

namespace craftfleet {
namespace {

constexpr int kSmallField = 64 * 64;  // cells; memory for larger fields comes from the heap

// Of a cell that is too near to a threshold of the step at hand; no cell has it in the end.
constexpr int32_t kUnsure = 1 << 16;

// The noise s(x * x_times / x_divided, y * y_times / y_divided, z, {size: 1}) of a cell (x, y).
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
  NoiseGrid grid() const { return {x_times / x_divided / size, y_times / y_divided / size, z}; }
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
// Ordered so that the traits in `of` and `not_of` are known when a rule needs them.
constexpr LayerTrait kLayerTraits[] = {
    {{6, 7}, 0.15, kPeak, 0, kCave},
    {{7, 3, 2, 1, 1, 5}, 0.4, kMountain, kCave, kTunnel},
    {{7, 3, 1, 5, 2, 1}, 0.4, kMountain, kCave | kTunnel, kTunnel},
    {{1, 8}, 0, kMountain, kCave | kTunnel, kCoalVein},
    {{2, 6}, 0.4, kMountain, kCave | kTunnel, kIronVein},
    {{6, 5}, 0.35, kPeak, kCave | kTunnel, kLavaField},
    {{4, 9}, -0.2, kShore, kStart | kMountain, kSandy},
    {{5, 7}, 0, 0, kStart | kMountain | kSandy | kSea, kForest},
};

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

// Whether each of `count` blocks of kFieldBlock cells has a cell to which the rule applies.
CRAFTFLEET_KERNEL_BODY void FindCellsLoop(const LayerTrait* rule, const int32_t* traits, int count, uint8_t* found) {
  const int32_t mask = rule->of | rule->not_of;
  const int32_t of = rule->of;
  for (int block = 0; block < count; ++block) {
    int32_t any = 0;
    for (int n = 0; n < kFieldBlock; ++n) any |= static_cast<int32_t>((traits[block * kFieldBlock + n] & mask) == of);
    found[block] = static_cast<uint8_t>(any);
  }
}
CRAFTFLEET_KERNEL(FindCells, FindCellsLoop)

class Terrain {
 public:
  Terrain(const SimplexNoise& noise, int width, int height, Position player)
      : noise_(noise),
        width_(width),
        height_(height),
        num_blocks_((height + kFieldBlock - 1) / kFieldBlock),
        stride_(num_blocks_ * kFieldBlock),
        player_(player),
        blocks_(num_blocks_),
        field_(width * stride_),
        traits_(width * stride_, 0) {}

  void Compute(absl::Span<uint16_t> traits) {
    ComputeBase();
    for (const LayerTrait& rule : kLayerTraits) AddTrait(rule);
    uint16_t* out = traits.data();
    for (int x = 0; x < width_; ++x) out = std::copy_n(&traits_[x * stride_], height_, out);
  }

 private:
  using Field = absl::FixedArray<float, kSmallField>;

  // Calls exact(position, traits) for the cells that are unsure.
  template <typename Exact>
  void Decide(const Exact& exact) {
    for (int x = 0; x < width_; ++x) {
      int32_t* traits = &traits_[x * stride_];
      int32_t any = 0;
      for (int y = 0; y < height_; ++y) any |= traits[y];
      if ((any & kUnsure) == 0) continue;
      for (int y = 0; y < height_; ++y) {
        if ((traits[y] & kUnsure) != 0) exact(Position{x, y}, &traits[y]);
      }
    }
  }

  void ComputeBase() {
    Field water(field_.size(), 0.0F);
    Field mountain(field_.size(), 0.0F);
    Field start(field_.size());
    Field start_error(field_.size());
    WantColumns([](int, int) { return true; });
    AddNoise(noise_, kWaterShape.grid(), 1, blocks_, stride_, water.data());
    AddNoise(noise_, kFineWaterShape.grid(), 0.15, blocks_, stride_, water.data());
    AddNoise(noise_, kMountainShape.grid(), 1 / 1.3, blocks_, stride_, mountain.data());
    AddNoise(noise_, kFineMountainShape.grid(), 0.3 / 1.3, blocks_, stride_, mountain.data());
    ComputeStart(start.data(), start_error.data());
    CompareHeights(start.data(), start_error.data(), water.data(), mountain.data(), static_cast<int>(field_.size()),
                   traits_.data());
    Decide([&](Position p, int32_t* traits) { *traits = ExactBaseTraits(noise_, p, player_); });
  }

  void ComputeStart(float* start, float* error) {
    const auto most_far_start = static_cast<float>(1 / (1 + std::exp(kFar - 4 - 2 * kNoiseBound)));
    std::fill_n(start, field_.size(), most_far_start / 2);
    std::fill_n(error, field_.size(), most_far_start / 2);
    const int first_x = std::max(0, player_.x - kFar);
    const int end_x = std::min(width_, player_.x + kFar + 1);
    const int first_y = std::max(0, player_.y - kFar);
    const int end_y = std::min(height_, player_.y + kFar + 1);
    WantColumns([&](int x, int block) {
      return x >= first_x && x < end_x && (block + 1) * kFieldBlock > first_y && block * kFieldBlock < end_y;
    });
    std::fill(field_.begin(), field_.end(), 0.0F);
    AddNoise(noise_, kStartShape.grid(), 1, blocks_, stride_, field_.data());
    for (int x = first_x; x < end_x; ++x) {
      for (int y = first_y; y < end_y; ++y) {
        const auto squared_distance = static_cast<float>(SquaredDistance({x, y}, player_));
        if (squared_distance > kFar * kFar) continue;
        const int n = x * stride_ + y;
        start[n] = 1 / (1 + std::exp(-(4 - std::sqrt(squared_distance) + 2 * field_[n])));
        error[n] = kNearStartError;
      }
    }
  }

  void AddTrait(const LayerTrait& rule) {
    std::fill(field_.begin(), field_.end(), 0.0F);
    absl::FixedArray<uint8_t, kSmallField / kFieldBlock> wanted(width_ * num_blocks_);
    FindCells(&rule, traits_.data(), static_cast<int>(wanted.size()), wanted.data());
    WantColumns([&](int x, int block) { return wanted[x * num_blocks_ + block] != 0; });
    AddNoise(noise_, rule.shape.grid(), 1, blocks_, stride_, field_.data());
    CompareLayer(&rule, field_.data(), static_cast<int>(field_.size()), traits_.data());
    Decide([&](Position p, int32_t* traits) {
      *traits &= ~(kUnsure | rule.trait);
      if (rule.shape.At(noise_, p) > rule.threshold) *traits |= rule.trait;
    });
  }

  // Sets blocks_ to the columns from the first to the last for which wanted(column, block).
  template <typename Wanted>
  void WantColumns(const Wanted& wanted) {
    for (int block = 0; block < num_blocks_; ++block) {
      ColumnRange& columns = blocks_[block] = {width_, 0};
      for (int x = 0; x < width_; ++x) {
        if (!wanted(x, block)) continue;
        columns.begin = std::min(columns.begin, x);
        columns.end = x + 1;
      }
    }
  }

  const SimplexNoise& noise_;
  const int width_;
  const int height_;
  const int num_blocks_;
  const int stride_;  // from one column of a field to the next: whole blocks
  const Position player_;
  absl::FixedArray<ColumnRange, 8> blocks_;  // where noise is computed
  Field field_;
  absl::FixedArray<int32_t, kSmallField> traits_;  // [width][stride]
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
