#include "envserver/world/terrain.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include <absl/types/span.h>

#include "common/base/multiversion.h"

namespace craftfleet {
namespace {

constexpr int kBlock = 512;  // cells worked on at a time: their intermediate values stay in the first cache

constexpr int kLanes = 16;  // divides kBlock

// Place of a cell of the world.
struct Place {
  uint8_t x, y;
};

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
      : x_(Coordinates(width, shape.x_times, shape.x_divided, shape.size)),
        y_(Coordinates(height, shape.y_times, shape.y_divided, shape.size)),
        plane_(noise, {x_.front(), x_.back(), y_.front(), y_.back()}, shape.z) {}

  // values[n] = at places[n], for at most kBlock of them; `values` has room for kBlock.
  void Sample(absl::Span<const Place> places, double* values) const {
    double x[kBlock];
    double y[kBlock];
    for (size_t n = 0; n < places.size(); ++n) {
      x[n] = x_[places[n].x];
      y[n] = y_[places[n].y];
    }
    // Whole vectors only: a scalar remainder costs more than some superfluous points.
    size_t count = places.size();
    for (; count % kLanes != 0; ++count) {
      x[count] = x_[0];
      y[count] = y_[0];
    }
    plane_.Evaluate(absl::MakeConstSpan(x, count), absl::MakeConstSpan(y, count), absl::MakeSpan(values, count));
  }

 private:
  // As Crafter computes them: the last bit counts.
  static std::vector<double> Coordinates(int count, double times, double divided, double size) {
    std::vector<double> coordinates(count);
    for (int i = 0; i < count; ++i) coordinates[i] = i * times / divided / size;
    return coordinates;
  }

  std::vector<double> x_;
  std::vector<double> y_;
  NoisePlane plane_;
};

// A trait that cells with all of the traits `of`, and none of `not_of`, have where a layer is above the threshold.
struct LayerTrait {
  Layer::Shape shape;
  double threshold;
  uint16_t of;
  uint16_t not_of;
  Trait trait;
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

// The values that determine the traits of cells before their layers; one array each so that loops over cells vectorise.
struct Heights {
  double water[kBlock];     // without the start's part
  double mountain[kBlock];  // without the start's and the water's part
  double start[kBlock];
};

// The traits that follow from the heights alone. Written as a sum of choices between doubles, because the loop
// vectorises only in this form.
CRAFTFLEET_MULTIVERSION void BaseTraits(const Heights& heights, int count, uint16_t* traits) {
  for (int n = 0; n < count; ++n) {
    const double start = heights.start[n];
    const double water = heights.water[n] - 2 * start;
    const double mountain = heights.mountain[n] - (4 * start + 0.3 * water);
    double sum = mountain > 0.15 ? double{kMountain} : 0.0;
    sum += mountain > 0.18 ? double{kHigh} : 0.0;
    sum += mountain > 0.3 ? double{kPeak} : 0.0;
    sum += water > 0.3 ? double{kSea} : 0.0;
    const double shore_or_not = water <= 0.35 ? double{kShore} : 0.0;
    sum += water > 0.25 ? shore_or_not : 0.0;
    traits[n] = static_cast<uint16_t>(static_cast<int32_t>(start > 0.5 ? double{kStart} : sum));
  }
}

double Logistic(double value) { return 1 / (1 + std::exp(-value)); }

class Terrain {
 public:
  Terrain(const SimplexNoise& noise, int width, int height, Position player)
      : player_(player),
        start_(noise, {8, 3}, width, height),
        water_(noise, {3, 15}, width, height),
        fine_water_(noise, {3, 5}, width, height),
        mountain_(noise, {0, 15}, width, height),
        fine_mountain_(noise, {0, 5}, width, height) {
    layers_.reserve(std::size(kLayerTraits));
    for (const LayerTrait& rule : kLayerTraits) layers_.emplace_back(noise, rule.shape, width, height);
  }

  // traits[n] of the cells at places[n], at most kBlock.
  void Compute(absl::Span<const Place> places, uint16_t* traits) const {
    Heights heights;
    ComputeHeights(places, &heights);
    ComputeBase(places, &heights, traits);
    for (size_t i = 0; i < layers_.size(); ++i) AddTrait(kLayerTraits[i], layers_[i], places, traits);
  }

 private:
  void ComputeHeights(absl::Span<const Place> places, Heights* heights) const {
    double fine_water[kBlock];
    double fine_mountain[kBlock];
    water_.Sample(places, heights->water);
    fine_water_.Sample(places, fine_water);
    mountain_.Sample(places, heights->mountain);
    fine_mountain_.Sample(places, fine_mountain);
    for (size_t n = 0; n < places.size(); ++n) {
      heights->water[n] = heights->water[n] + 0.15 * fine_water[n] + 0.1;
      heights->mountain[n] = (heights->mountain[n] + 0.3 * fine_mountain[n]) / 1.3;
    }
  }

  // Far from the player, start is nearly 0: its noise is computed only where it could make a difference.
  void ComputeBase(absl::Span<const Place> places, Heights* heights, uint16_t* traits) const {
    constexpr double kFar = 16;  // cells
    const double most_far_start = Logistic(4 - kFar + 2 * kNoiseBound);
    constexpr double kBelowZero = -1e-9;  // below 0, so that rounding does not matter
    const int count = static_cast<int>(places.size());
    uint16_t other_traits[kBlock];
    std::fill_n(heights->start, count, most_far_start);
    BaseTraits(*heights, count, other_traits);
    std::fill_n(heights->start, count, kBelowZero);
    BaseTraits(*heights, count, traits);

    Place asked[kBlock];
    int asked_at[kBlock];
    int num_asked = 0;
    for (int n = 0; n < count; ++n) {
      asked[num_asked] = places[n];
      asked_at[num_asked] = n;
      num_asked += static_cast<int>(traits[n] != other_traits[n] || SquaredDistance(places[n]) < kFar * kFar);
    }
    double noise[kBlock];
    start_.Sample(absl::MakeConstSpan(asked, num_asked), noise);
    for (int i = 0; i < num_asked; ++i) {
      heights->start[asked_at[i]] = Logistic(4 - std::sqrt(SquaredDistance(asked[i])) + 2 * noise[i]);
    }
    if (num_asked > 0) BaseTraits(*heights, count, traits);
  }

  static void AddTrait(const LayerTrait& rule, const Layer& layer, absl::Span<const Place> places, uint16_t* traits) {
    Place asked[kBlock];
    int asked_at[kBlock];
    int count = 0;
    const int mask = rule.of | rule.not_of;
    for (size_t n = 0; n < places.size(); ++n) {
      asked[count] = places[n];
      asked_at[count] = static_cast<int>(n);
      count += static_cast<int>((traits[n] & mask) == rule.of);
    }
    double values[kBlock];
    layer.Sample(absl::MakeConstSpan(asked, count), values);
    for (int i = 0; i < count; ++i) {
      if (values[i] > rule.threshold) traits[asked_at[i]] |= rule.trait;
    }
  }

  double SquaredDistance(Place place) const {
    const double dx = place.x - player_.x;
    const double dy = place.y - player_.y;
    return dx * dx + dy * dy;
  }

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
  std::vector<Place> places;
  places.reserve(static_cast<size_t>(width) * height);
  for (int x = 0; x < width; ++x) {
    for (int y = 0; y < height; ++y) places.push_back({static_cast<uint8_t>(x), static_cast<uint8_t>(y)});
  }
  const Terrain terrain(noise, width, height, player);
  std::vector<uint16_t> traits(places.size());
  for (size_t first = 0; first < places.size(); first += kBlock) {
    const size_t count = std::min<size_t>(kBlock, places.size() - first);
    terrain.Compute(absl::MakeConstSpan(places).subspan(first, count), traits.data() + first);
  }
  return traits;
}

}  // namespace craftfleet
