#include "envserver/world/noise_field.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "common/base/cpu_path.h"

namespace craftfleet {
namespace {

constexpr int kMaxColumns = 256;
const double kReach = std::sqrt(2.0);  // of a lattice point

// A block of rows. The compilers' vector types become what the CPU has.
using Vector = float __attribute__((vector_size(kFieldBlock * sizeof(float))));
constexpr Vector kCount = {0, 1, 2, 3, 4, 5, 6, 7};

// A lattice point in reach of the grid's plane: its place in the plane, and what its contribution is made of.
struct LatticePoint {
  double x, y;
  double reach;  // in the plane
  float squared_reach;
  float gradient_x, gradient_y;
  float along_z;  // the part across the plane of the product of gradient and displacement
};

// The cells of a row or column whose coordinate is within `reach` of `center`, clipped to `all`.
struct Cells : ColumnRange {
  Cells(double center, double reach, double per_unit, ColumnRange all)
      : ColumnRange{std::max(all.begin, static_cast<int>(std::ceil((center - reach) * per_unit))),
                    std::min(all.end, static_cast<int>(std::floor((center + reach) * per_unit)) + 1)} {}
};

// Adds what one lattice point contributes to each cell in its reach: attenuation^4 * (gradient . displacement).
CRAFTFLEET_KERNEL_BODY void AddPoint(const NoiseGrid& grid, const LatticePoint& point, ColumnRange all,
                                     absl::Span<const ColumnRange> blocks, int stride, float* field) {
  const Cells columns(point.x, point.reach, 1 / grid.step_x, all);
  const Cells rows(point.y, point.reach, 1 / grid.step_y, {0, static_cast<int>(blocks.size()) * kFieldBlock});
  const int count = columns.end - columns.begin;
  if (count <= 0 || rows.begin >= rows.end) return;
  // By column: the squared reach that is left, and the gradient's part.
  float reach_left[kMaxColumns];
  float along_xz[kMaxColumns];
  const auto first_x = static_cast<float>(columns.begin * grid.step_x - point.x);
  const auto step_x = static_cast<float>(grid.step_x);
  for (int block = 0; block < count; block += kFieldBlock) {
    for (int n = block; n < block + kFieldBlock; ++n) {
      const float x = first_x + step_x * static_cast<float>(n);
      reach_left[n] = point.squared_reach - x * x;
      along_xz[n] = point.along_z + point.gradient_x * x;
    }
  }
  const auto step_y = static_cast<float>(grid.step_y);
  for (int block = rows.begin / kFieldBlock; block * kFieldBlock < rows.end; ++block) {
    const Vector y = static_cast<float>(block * kFieldBlock * grid.step_y - point.y) + step_y * kCount;
    const Vector squared = y * y;
    const Vector along = point.gradient_y * y;
    const int begin = std::max(columns.begin, blocks[block].begin);
    const int end = std::min(columns.end, blocks[block].end);
    float* values = field + block * kFieldBlock + begin * stride;
    for (int n = begin - columns.begin; n < end - columns.begin; ++n, values += stride) {
      Vector attenuation = reach_left[n] - squared;
      attenuation = attenuation > 0 ? attenuation : Vector{};
      attenuation *= attenuation;
      Vector sum;
      std::memcpy(&sum, values, sizeof(sum));
      sum += attenuation * attenuation * (along_xz[n] + along);
      std::memcpy(values, &sum, sizeof(sum));
    }
  }
}

// The lattice points (i, j, k) in reach of the columns `all` of the blocks. With s = i + j + k they are at
// (i + s/3, j + s/3, k + s/3).
CRAFTFLEET_KERNEL_BODY void AddNoiseLoop(const SimplexNoise* noise, const NoiseGrid* grid, double weight,
                                         ColumnRange all, absl::Span<const ColumnRange> blocks, int stride,
                                         float* field) {
  const double min_x = all.begin * grid->step_x;
  const double max_x = (all.end - 1) * grid->step_x;
  const double min_y = 0;
  const double max_y = (static_cast<int>(blocks.size()) * kFieldBlock - 1) * grid->step_y;
  const auto scale = static_cast<float>(weight / kNoiseNorm);
  // The coordinates of a point in reach differ by at most sqrt(3) * sqrt(2), less than 2.5, in sum from those of a
  // cell.
  const int max_s = static_cast<int>(std::floor((max_x + max_y + grid->z + 2.5) / 2));
  for (int s = static_cast<int>(std::ceil((min_x + min_y + grid->z - 2.5) / 2)); s <= max_s; ++s) {
    const double shift = s / 3.0;
    const int max_k = static_cast<int>(std::floor(grid->z - shift + kReach));
    for (int k = static_cast<int>(std::ceil(grid->z - shift - kReach)); k <= max_k; ++k) {
      const double z = grid->z - (k + shift);
      const double squared_reach = 2 - z * z;
      if (squared_reach <= 0) continue;
      const double reach = std::sqrt(squared_reach);
      // From the reach in x, and in y, where j = s - k - i.
      const double high_j = s - k + shift;
      const int min_i = static_cast<int>(std::ceil(std::max(min_x - reach - shift, high_j - max_y - reach)));
      const int max_i = static_cast<int>(std::floor(std::min(max_x + reach - shift, high_j - min_y + reach)));
      for (int i = min_i; i <= max_i; ++i) {
        const SimplexNoise::Gradient& gradient = noise->GradientAt(i, s - k - i, k);
        const LatticePoint point = {i + shift,
                                    high_j - i,
                                    reach,
                                    static_cast<float>(squared_reach),
                                    scale * gradient.x,
                                    scale * gradient.y,
                                    scale * static_cast<float>(z) * gradient.z};
        AddPoint(*grid, point, all, blocks, stride, field);
      }
    }
  }
}
CRAFTFLEET_KERNEL(AddNoiseKernel, AddNoiseLoop)

}  // namespace

void AddNoise(const SimplexNoise& noise, const NoiseGrid& grid, double weight, absl::Span<const ColumnRange> blocks,
              int stride, float* field) {
  ColumnRange all = {kMaxColumns, 0};
  for (const ColumnRange& columns : blocks) {
    if (columns.begin >= columns.end) continue;
    all.begin = std::min(all.begin, columns.begin);
    all.end = std::max(all.end, columns.end);
  }
  if (all.begin < all.end) AddNoiseKernel(&noise, &grid, weight, all, blocks, stride, field);
}

}  // namespace craftfleet
