#include "envserver/world/noise_field.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "common/base/cpu_path.h"

namespace craftfleet {
namespace {

// One or two columns of a tile: what fits into the vectors of the CPU.
using Column = float __attribute__((vector_size(kTileSize * sizeof(float))));
using TwoColumns = float __attribute__((vector_size(2 * kTileSize * sizeof(float))));

// The gradients by number, times the weight.
using Gradients = std::array<float, 3>[256];

// Where the cells of a tile's first two columns are, from its first cell. In memory, where the compiler does not see
// that the x of a column are equal: it would compute them as scalars, and need more operations to spread them over
// vectors.
struct Cells {
  Cells(float step_x, float step_y) : next_column(step_x) {
    for (int n = 0; n < 2 * kTileSize; ++n) {
      x[n] = step_x * static_cast<float>(n / kTileSize);
      y[n] = step_y * static_cast<float>(n % kTileSize);
    }
  }

  float x[2 * kTileSize];
  float y[2 * kTileSize];
  float next_column;
};

// Adds to each cell of a tile, values[kTileSize][kTileSize], what the lattice points contribute: attenuation^4 *
// (gradient . displacement).
template <typename Vector>
CRAFTFLEET_KERNEL_BODY void AddPointsLoop(const SimplexNoise* noise, const Gradients* gradients, const Cells* cells,
                                          absl::Span<const NoiseField::Point> points, float* values) {
  constexpr int kStep = sizeof(Vector) / sizeof(Column);
  constexpr int kSteps = kTileSize / kStep;
  Vector cells_x;
  Vector cells_y;
  std::memcpy(&cells_x, cells->x, sizeof(cells_x));
  std::memcpy(&cells_y, cells->y, sizeof(cells_y));
  const float step_x = kStep * cells->next_column;
  Vector sums[kSteps];
  std::memcpy(sums, values, sizeof(sums));
  for (const NoiseField::Point& point : points) {
    const std::array<float, 3>& gradient = (*gradients)[noise->GradientNumber(point.i, point.j, point.k)];
    const Vector y = cells_y - point.y;
    const Vector reach_left = point.squared_reach - y * y;
    const Vector along_yz = gradient[2] * point.z + gradient[1] * y;
    Vector x = cells_x - point.x;
    for (int step = 0; step < kSteps; ++step) {
      Vector attenuation = reach_left - x * x;
      attenuation = attenuation > 0 ? attenuation : Vector{};
      attenuation *= attenuation;
      sums[step] += attenuation * attenuation * (along_yz + gradient[0] * x);
      x += step_x;
    }
  }
  std::memcpy(values, sums, sizeof(sums));
}
CRAFTFLEET_WIDE_KERNEL(AddPoints, AddPointsLoop<TwoColumns>, AddPointsLoop<Column>)

// How far a coordinate is from low..high; 0 within.
double Distance(double value, double low, double high) { return std::max({low - value, value - high, 0.0}); }

}  // namespace

NoiseField::NoiseField(double step_x, double step_y, double z) : step_x_(step_x), step_y_(step_y), z_(z) {
  for (int n = 0; n < kKept * kKept; ++n) points_[n] = PointsOf(n % kKept, n / kKept);
}

// The lattice point (i, j, k) is at (i + s/3, j + s/3, k + s/3), where s = i + j + k.
std::vector<NoiseField::Point> NoiseField::PointsOf(int column, int row) const {
  const double reach = std::sqrt(2.0);
  const double min_x = column * kTileSize * step_x_;
  const double max_x = min_x + (kTileSize - 1) * step_x_;
  const double min_y = row * kTileSize * step_y_;
  const double max_y = min_y + (kTileSize - 1) * step_y_;
  std::vector<Point> points;
  // The coordinates of a point in reach of a cell differ from the cell's by at most sqrt(3) * sqrt(2), less than 2.5,
  // in sum, and the sum of a point's is 2 * s.
  const int max_s = static_cast<int>(std::floor((max_x + max_y + z_ + 2.5) / 2));
  for (int s = static_cast<int>(std::ceil((min_x + min_y + z_ - 2.5) / 2)); s <= max_s; ++s) {
    const double shift = s / 3.0;
    const int max_k = static_cast<int>(std::floor(z_ - shift + reach));
    for (int k = static_cast<int>(std::ceil(z_ - shift - reach)); k <= max_k; ++k) {
      const double z = z_ - (k + shift);
      const double squared_reach = 2 - z * z;
      const int max_i = static_cast<int>(std::floor(max_x - shift + reach));
      for (int i = static_cast<int>(std::ceil(min_x - shift - reach)); i <= max_i; ++i) {
        const int j = s - k - i;
        const double x = i + shift;
        const double y = j + shift;
        const double x_distance = Distance(x, min_x, max_x);
        const double y_distance = Distance(y, min_y, max_y);
        if (x_distance * x_distance + y_distance * y_distance >= squared_reach) continue;
        points.push_back({static_cast<float>(x - min_x), static_cast<float>(y - min_y), static_cast<float>(z),
                          static_cast<float>(squared_reach), static_cast<uint8_t>(i), static_cast<uint8_t>(j),
                          static_cast<uint8_t>(k)});
      }
    }
  }
  return points;
}

void NoiseField::Add(const SimplexNoise& noise, double weight, int tile_columns, absl::Span<const uint32_t> wanted,
                     float* values) const {
  const auto scale = static_cast<float>(weight / kNoiseNorm);
  Gradients gradients;
  for (int n = 0; n < 256; ++n) {
    const SimplexNoise::Gradient& gradient = noise.GradientWithNumber(n);
    gradients[n] = {scale * gradient.x, scale * gradient.y, scale * gradient.z};
  }
  const Cells cells(static_cast<float>(step_x_), static_cast<float>(step_y_));
  for (int row = 0; row < static_cast<int>(wanted.size()); ++row) {
    for (int column = 0; column < tile_columns; ++column) {
      if ((wanted[row] >> column & 1) == 0) continue;
      float* tile = values + (row * tile_columns + column) * kTileCells;
      if (column < kKept && row < kKept) {
        AddPoints(&noise, &gradients, &cells, absl::MakeConstSpan(points_[row * kKept + column]), tile);
      } else {
        const std::vector<Point> points = PointsOf(column, row);
        AddPoints(&noise, &gradients, &cells, absl::MakeConstSpan(points), tile);
      }
    }
  }
}

}  // namespace craftfleet
