#include "envserver/world/terrain.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include <absl/types/span.h>

#include "common/check.h"

namespace craftfleet {
namespace {

constexpr int kBlock = 512;  // cells worked on at a time: their intermediate values stay in the first cache

// s(x * x_scale, y * y_scale, z, {size: 1}) for all cells of a world.
class Layer {
 public:
  struct Shape {
    double z;
    double size;
    double x_times = 1;
    double x_divided = 1;
    double y_times = 1;
    double y_divided = 1;
  };

  Layer(const SimplexNoise& noise, const Shape& shape, int width, int height)
      : height_(height),
        x_(Coordinates(width, shape.x_times, shape.x_divided, shape.size)),
        y_(Coordinates(height, shape.y_times, shape.y_divided, shape.size)),
        plane_(noise, {x_.front(), x_.back(), y_.front(), y_.back()}, shape.z) {}

  // values[n] = of cells[n], indices x * height + y.
  void Sample(absl::Span<const int> cells, absl::Span<double> values) const {
    std::array<double, kBlock> x;
    std::array<double, kBlock> y;
    CRAFTFLEET_CHECK(cells.size() <= kBlock);
    for (size_t n = 0; n < cells.size(); ++n) {
      x[n] = x_[cells[n] / height_];
      y[n] = y_[cells[n] % height_];
    }
    plane_.Evaluate(absl::MakeConstSpan(x.data(), cells.size()), absl::MakeConstSpan(y.data(), cells.size()), values);
  }

 private:
  // As Crafter computes them: the last bit counts.
  static std::vector<double> Coordinates(int count, double times, double divided, double size) {
    std::vector<double> coordinates(count);
    for (int i = 0; i < count; ++i) coordinates[i] = i * times / divided / size;
    return coordinates;
  }

  int height_;
  std::vector<double> x_;
  std::vector<double> y_;
  NoisePlane plane_;
};

// A trait that cells with all of the traits `of`, and none of `not_of`, have where a layer is above the threshold.
struct LayerTrait {
  Layer::Shape shape;
  uint16_t of;
  uint16_t not_of;
  double threshold;
  Trait trait;
};
// In an order in which each rule's `of` and `not_of` are known before.
constexpr LayerTrait kLayerTraits[] = {
    {{6, 7}, kPeak, 0, 0.15, kCave},
    {{7, 3, 2, 1, 1, 5}, kMountain, kCave, 0.4, kTunnel},
    {{7, 3, 1, 5, 2, 1}, kMountain, kCave | kTunnel, 0.4, kTunnel},
    {{1, 8}, kMountain, kCave | kTunnel, 0, kCoalVein},
    {{2, 6}, kMountain, kCave | kTunnel, 0.4, kIronVein},
    {{6, 5}, kPeak, kCave | kTunnel, 0.35, kLavaField},
    {{4, 9}, kShore, kStart | kMountain, -0.2, kSandy},
    {{5, 7}, 0, kStart | kMountain | kSandy | kSea, 0, kForest},
};

struct Heights {
  double water;     // without the start's part
  double mountain;  // without the start's and water's part
};

// Those traits that heights and start alone decide.
uint16_t BaseTraits(const Heights& heights, double start) {
  if (start > 0.5) return kStart;
  const double water = heights.water - 2 * start;
  const double mountain = heights.mountain - (4 * start + 0.3 * water);
  uint16_t traits = 0;
  if (mountain > 0.15) traits |= kMountain;
  if (mountain > 0.18) traits |= kHigh;
  if (mountain > 0.3) traits |= kPeak;
  if (0.25 < water && water <= 0.35) traits |= kShore;
  if (0.3 < water) traits |= kSea;
  return traits;
}

double Logistic(double value) { return 1 / (1 + std::exp(-value)); }

class Terrain {
 public:
  Terrain(const SimplexNoise& noise, int width, int height, Position player)
      : height_(height),
        player_(player),
        start_(noise, {8, 3}, width, height),
        water_(noise, {3, 15}, width, height),
        fine_water_(noise, {3, 5}, width, height),
        mountain_(noise, {0, 15}, width, height),
        fine_mountain_(noise, {0, 5}, width, height) {
    for (const LayerTrait& rule : kLayerTraits) layers_.emplace_back(noise, rule.shape, width, height);
  }

  // traits[n] of the cells from `first`, at most kBlock.
  void Compute(int first, absl::Span<uint16_t> traits) const {
    ComputeBase(first, traits);
    for (size_t i = 0; i < layers_.size(); ++i) AddTrait(kLayerTraits[i], layers_[i], first, traits);
  }

 private:
  void ComputeBase(int first, absl::Span<uint16_t> traits) const {
    std::array<int, kBlock> cell_array;
    const absl::Span<int> cells = absl::MakeSpan(cell_array).first(traits.size());
    std::iota(cells.begin(), cells.end(), first);
    std::array<double, kBlock> water;
    std::array<double, kBlock> fine_water;
    std::array<double, kBlock> mountain;
    std::array<double, kBlock> fine_mountain;
    water_.Sample(cells, absl::MakeSpan(water).first(cells.size()));
    fine_water_.Sample(cells, absl::MakeSpan(fine_water).first(cells.size()));
    mountain_.Sample(cells, absl::MakeSpan(mountain).first(cells.size()));
    fine_mountain_.Sample(cells, absl::MakeSpan(fine_mountain).first(cells.size()));
    std::array<Heights, kBlock> heights;
    for (size_t n = 0; n < cells.size(); ++n) {
      heights[n].water = water[n] + 0.15 * fine_water[n] + 0.1;
      heights[n].mountain = (mountain[n] + 0.3 * fine_mountain[n]) / 1.3;
    }
    ApplyStart(cells, heights.data(), traits);
  }

  // Far from the player start is next to nothing: its noise is looked at only where it could make a difference.
  void ApplyStart(absl::Span<const int> cells, const Heights* heights, absl::Span<uint16_t> traits) const {
    std::array<int, kBlock> near_cells;
    std::array<int, kBlock> near;
    int num_near = 0;
    for (size_t n = 0; n < cells.size(); ++n) {
      const double most = Logistic(4 - DistanceToPlayer(cells[n]) + 2 * kNoiseBound);
      traits[n] = BaseTraits(heights[n], most);
      constexpr double kBelowZero = -1e-9;  // so that no rounding matters
      if (traits[n] == BaseTraits(heights[n], kBelowZero)) continue;
      near_cells[num_near] = cells[n];
      near[num_near++] = static_cast<int>(n);
    }
    std::array<double, kBlock> noise;
    start_.Sample(absl::MakeConstSpan(near_cells).first(num_near), absl::MakeSpan(noise).first(num_near));
    for (int i = 0; i < num_near; ++i) {
      const double start = Logistic(4 - DistanceToPlayer(near_cells[i]) + 2 * noise[i]);
      traits[near[i]] = BaseTraits(heights[near[i]], start);
    }
  }

  static void AddTrait(const LayerTrait& rule, const Layer& layer, int first, absl::Span<uint16_t> traits) {
    std::array<int, kBlock> cells;
    int count = 0;
    for (size_t n = 0; n < traits.size(); ++n) {
      cells[count] = first + static_cast<int>(n);
      count += static_cast<int>((traits[n] & (rule.of | rule.not_of)) == rule.of);
    }
    std::array<double, kBlock> values;
    layer.Sample(absl::MakeConstSpan(cells).first(count), absl::MakeSpan(values).first(count));
    for (int i = 0; i < count; ++i) {
      if (values[i] > rule.threshold) traits[cells[i] - first] |= rule.trait;
    }
  }

  double DistanceToPlayer(int cell) const {
    const double dx = cell / height_ - player_.x;
    const double dy = cell % height_ - player_.y;
    return std::sqrt(dx * dx + dy * dy);
  }

  const int height_;
  const Position player_;
  const Layer start_;
  const Layer water_;
  const Layer fine_water_;
  const Layer mountain_;
  const Layer fine_mountain_;
  std::vector<Layer> layers_;  // of kLayerTraits
};

}  // namespace

std::vector<uint16_t> ComputeTraits(const SimplexNoise& noise, int width, int height, Position player) {
  const Terrain terrain(noise, width, height, player);
  std::vector<uint16_t> traits(static_cast<size_t>(width) * height);
  for (size_t first = 0; first < traits.size(); first += kBlock) {
    const size_t count = std::min<size_t>(kBlock, traits.size() - first);
    terrain.Compute(static_cast<int>(first), absl::MakeSpan(traits).subspan(first, count));
  }
  return traits;
}

}  // namespace craftfleet
