#include "envserver/world/simplex_noise.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/base/check.h"
#include "common/base/multiversion.h"

namespace craftfleet {
namespace {

constexpr double kStretch = -1.0 / 6;
constexpr double kSquish = 1.0 / 3;
constexpr double kNorm = 103;

// The place of a point in its skewed unit cube decides which lattice points count. Two planes divide the cube.
enum Region : int32_t { kLow = 1, kMiddle = 2, kHigh = 4 };

// A corner of the cube: its offset, and the regions in which it counts. Summed in this order.
struct Corner {
  int32_t i, j, k;
  int32_t regions;
};
constexpr Corner kCorners[] = {
    {0, 0, 0, kLow},
    {1, 0, 0, kLow | kMiddle},
    {0, 1, 0, kLow | kMiddle},
    {0, 0, 1, kLow | kMiddle},
    {1, 1, 0, kMiddle | kHigh},
    {1, 0, 1, kMiddle | kHigh},
    {0, 1, 1, kMiddle | kHigh},
    {1, 1, 1, kHigh},
};

// Two farther lattice points count too; a case number selects them. The order of the terms of their displacement
// determines its last bit: minus the offset, minus squish * kSquish, minus `late`. So `late` is separate, and the whole
// offset is offset + late. Packed, two bits each from the lowest: offset x y z plus 1, squish, late x y z.
constexpr int32_t Pack(int i, int j, int k, int squish, int late_i = 0, int late_j = 0, int late_k = 0) {
  return (i + 1) | (j + 1) << 2 | (k + 1) << 4 | squish << 6 | late_i << 8 | late_j << 10 | late_k << 12;
}
struct Extras {
  int32_t first[64] = {};
  int32_t second[64] = {};
  constexpr void Set(int number, int32_t first_point, int32_t second_point) {
    first[number] = first_point;
    second[number] = second_point;
  }
  // In either order of the picks.
  constexpr void SetMiddle(int pick, int other, int32_t first_point, int32_t second_point) {
    Set(8 * pick + other, first_point, second_point);
    Set(8 * other + pick, first_point, second_point);
  }
};
// Sets of axes have the bits x 1, y 2, z 4. Case numbers: low region 8 * 0 + axes, high region 8 * 7 + axes, middle
// region 8 * one pick + other pick, see MiddleCase().
constexpr int kHighCase = 8 * 7;
constexpr Extras MakeExtras() {
  Extras extras;
  extras.Set(1, Pack(1, -1, 0, 0), Pack(1, 0, -1, 0));
  extras.Set(2, Pack(-1, 1, 0, 0), Pack(0, 1, -1, 0));
  extras.Set(4, Pack(-1, 0, 1, 0), Pack(0, -1, 1, 0));
  extras.Set(3, Pack(1, 1, 0, 2), Pack(1, 1, -1, 1));
  extras.Set(5, Pack(1, 0, 1, 2), Pack(1, -1, 1, 1));
  extras.Set(6, Pack(0, 1, 1, 2), Pack(-1, 1, 1, 1));
  // The axes are those on which the extra points are not farther out.
  extras.Set(kHighCase + 4, Pack(2, 1, 0, 3), Pack(1, 1, 0, 3, 0, 1, 0));
  extras.Set(kHighCase + 2, Pack(2, 0, 1, 3), Pack(1, 0, 2, 3));
  extras.Set(kHighCase + 1, Pack(0, 1, 1, 3, 0, 1, 0), Pack(0, 1, 2, 3));
  extras.Set(kHighCase + 6, Pack(1, 0, 0, 1), Pack(2, 0, 0, 2));
  extras.Set(kHighCase + 5, Pack(0, 1, 0, 1), Pack(0, 2, 0, 2));
  extras.Set(kHighCase + 3, Pack(0, 0, 1, 1), Pack(0, 0, 2, 2));
  // Both picks far: beyond the far corner, and twice their common axis.
  extras.SetMiddle(3, 5, Pack(1, 1, 1, 3), Pack(2, 0, 0, 2));
  extras.SetMiddle(3, 6, Pack(1, 1, 1, 3), Pack(0, 2, 0, 2));
  extras.SetMiddle(5, 6, Pack(1, 1, 1, 3), Pack(0, 0, 2, 2));
  // Both near: the origin, and both axes less the third.
  extras.SetMiddle(1, 2, Pack(0, 0, 0, 0), Pack(1, 1, -1, 1));
  extras.SetMiddle(1, 4, Pack(0, 0, 0, 0), Pack(1, -1, 1, 1));
  extras.SetMiddle(2, 4, Pack(0, 0, 0, 0), Pack(-1, 1, 1, 1));
  // One far, one near: the far pair less the third axis, and twice the near axis.
  extras.SetMiddle(3, 1, Pack(1, 1, -1, 1), Pack(0, 0, 0, 2, 2, 0, 0));
  extras.SetMiddle(3, 2, Pack(1, 1, -1, 1), Pack(0, 0, 0, 2, 0, 2, 0));
  extras.SetMiddle(5, 1, Pack(1, -1, 1, 1), Pack(0, 0, 0, 2, 2, 0, 0));
  extras.SetMiddle(5, 4, Pack(1, -1, 1, 1), Pack(0, 0, 0, 2, 0, 0, 2));
  extras.SetMiddle(6, 2, Pack(-1, 1, 1, 1), Pack(0, 0, 0, 2, 0, 2, 0));
  extras.SetMiddle(6, 4, Pack(-1, 1, 1, 1), Pack(0, 0, 0, 2, 0, 0, 2));
  return extras;
}
constexpr Extras kExtras = MakeExtras();

constexpr int kBlock = 64;  // points worked on at a time: their intermediate values stay in the first cache

// Intermediate values of the points, one array each so that loops over points vectorise.
struct Block {
  double x[kBlock], y[kBlock], z[kBlock];     // displacement from the cube's origin
  int32_t origin[kBlock];                     // index of the cube's origin in the lattice
  double fx[kBlock], fy[kBlock], fz[kBlock];  // place inside the skewed cube, 0..1
  int32_t region[kBlock];
  int32_t extras[kBlock];  // case number
  double value[kBlock];
};

// Cases and axes are computed as doubles, by choices between two values: the loops vectorise only in this form.
inline double Larger(double a, double b) { return a > b ? a : b; }
inline double Smaller(double a, double b) { return a < b ? a : b; }

// The axes that determine the case in the low region: of the two axes with the larger parts, the larger one if `origin`
// exceeds the smaller part, else both.
inline double LowAxes(double x, double y, double z, double origin) {
  const double a = x < y ? Larger(z, x) : x;
  const double b = x < y ? y : Larger(z, y);
  const double a_axis = x < y ? (z > x ? 4.0 : 1.0) : 1.0;
  const double b_axis = x < y ? 2.0 : (z > y ? 4.0 : 2.0);
  const double larger = b > a ? b_axis : a_axis;
  return origin > Smaller(a, b) ? larger : a_axis + b_axis;
}

// In the middle region each of xy, xz, yz has a far pick, the two axes, and a near one, the third axis: the sign of the
// pair's sum, less 1, decides. The two picks that count are those of the two sums farthest from 0.
inline double MiddleCase(double x, double y, double z) {
  const double xy = x + y - 1;
  const double xz = x + z - 1;
  const double yz = y + z - 1;
  const double xy_size = std::abs(xy);
  const double xz_size = std::abs(xz);
  const double yz_size = std::abs(yz);
  const double xy_pick = xy > 0 ? 3.0 : 4.0;
  const double xz_pick = xz > 0 ? 5.0 : 2.0;
  const double yz_pick = yz > 0 ? 6.0 : 1.0;
  const double first = xy_size <= xz_size ? (xy_size < yz_size ? yz_pick : xy_pick) : xy_pick;
  const double second = xy_size <= xz_size ? xz_pick : (xz_size < yz_size ? yz_pick : xz_pick);
  return 8 * first + second;
}

// The lattice points in reach of a plane's area: index of (i, j, k) = i * stride_i + j * stride_j + k - first.
struct Lattice {
  const uint32_t* gradients;
  int32_t stride_i;
  int32_t stride_j;
  int32_t first;
};

CRAFTFLEET_MULTIVERSION void Locate(const Lattice& lattice, const double* x, const double* y, double z, int count,
                                    Block* block) {
  for (int n = 0; n < count; ++n) {
    const double stretch = (x[n] + y[n] + z) * kStretch;
    const double sx = x[n] + stretch;
    const double sy = y[n] + stretch;
    const double sz = z + stretch;
    const double i = std::floor(sx);
    const double j = std::floor(sy);
    const double k = std::floor(sz);
    const double squish = (i + j + k) * kSquish;
    block->x[n] = x[n] - (i + squish);
    block->y[n] = y[n] - (j + squish);
    block->z[n] = z - (k + squish);
    block->origin[n] = static_cast<int32_t>(i * lattice.stride_i + j * lattice.stride_j + k - lattice.first);
    block->fx[n] = sx - i;
    block->fy[n] = sy - j;
    block->fz[n] = sz - k;
  }
}

CRAFTFLEET_MULTIVERSION void Classify(int count, Block* block) {
  for (int n = 0; n < count; ++n) {
    const double x = block->fx[n];
    const double y = block->fy[n];
    const double z = block->fz[n];
    const double sum = x + y + z;
    const double sign = sum >= 2 ? -1.0 : 1.0;
    // The high region is the low one mirrored.
    const double axes = LowAxes(sign * x, sign * y, sign * z, sum >= 2 ? sum - 3 : 1 - sum);
    const double middle_or_high = sum >= 2 ? kHighCase + axes : MiddleCase(x, y, z);
    const double region_if_not_low = sum >= 2 ? double{kHigh} : double{kMiddle};
    block->region[n] = static_cast<int32_t>(sum <= 1 ? double{kLow} : region_if_not_low);
    block->extras[n] = static_cast<int32_t>(sum <= 1 ? axes : middle_or_high);
  }
}

// The contribution of a lattice point at the displacement (x, y, z) from it.
inline double Contribution(uint32_t gradient, double x, double y, double z) {
  const double gx = static_cast<int32_t>(gradient << 24) >> 24;
  const double gy = static_cast<int32_t>(gradient << 16) >> 24;
  const double gz = static_cast<int32_t>(gradient << 8) >> 24;
  double attenuation = 2 - x * x - y * y - z * z;
  const bool counts = attenuation > 0;
  attenuation *= attenuation;
  const double contribution = attenuation * attenuation * (gx * x + gy * y + gz * z);
  return counts ? contribution : 0.0;
}

CRAFTFLEET_MULTIVERSION void AddCorner(const Lattice& lattice, const Corner& corner, int count, Block* block) {
  const double squish = (corner.i + corner.j + corner.k) * kSquish;
  const uint32_t* gradients = lattice.gradients + corner.i * lattice.stride_i + corner.j * lattice.stride_j + corner.k;
  for (int n = 0; n < count; ++n) {
    const double contribution = Contribution(gradients[block->origin[n]], block->x[n] - corner.i - squish,
                                             block->y[n] - corner.j - squish, block->z[n] - corner.k - squish);
    block->value[n] += (block->region[n] & corner.regions) != 0 ? contribution : 0.0;
  }
}

CRAFTFLEET_MULTIVERSION void AddExtra(const Lattice& lattice, const int32_t* points, int count, Block* block) {
  for (int n = 0; n < count; ++n) {
    const int32_t point = points[block->extras[n]];
    const int32_t i = (point & 3) - 1;
    const int32_t j = (point >> 2 & 3) - 1;
    const int32_t k = (point >> 4 & 3) - 1;
    const double squish = (point >> 6 & 3) * kSquish;
    const int32_t late_i = point >> 8 & 3;
    const int32_t late_j = point >> 10 & 3;
    const int32_t late_k = point >> 12 & 3;
    const int32_t offset = (i + late_i) * lattice.stride_i + (j + late_j) * lattice.stride_j + k + late_k;
    block->value[n] += Contribution(lattice.gradients[block->origin[n] + offset], block->x[n] - i - squish - late_i,
                                    block->y[n] - j - squish - late_j, block->z[n] - k - squish - late_k);
  }
}

int64_t NextState(int64_t state) {
  return static_cast<int64_t>(static_cast<uint64_t>(state) * 6364136223846793005ULL + 1442695040888963407ULL);
}

// Components are 11 on one axis, 4 on the others; the sign of each axis is a bit of number / 3.
uint32_t PackedGradient(int number) {
  constexpr int kSigns[8][3] = {{-1, 1, 1},  {1, 1, 1},  {-1, -1, 1},  {1, -1, 1},
                                {-1, 1, -1}, {1, 1, -1}, {-1, -1, -1}, {1, -1, -1}};
  uint32_t packed = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const int component = kSigns[number / 3][axis] * (number % 3 == axis ? 11 : 4);
    packed |= static_cast<uint32_t>(static_cast<uint8_t>(component)) << (8 * axis);
  }
  return packed;
}

}  // namespace

SimplexNoise::SimplexNoise(int64_t seed) {
  std::array<uint8_t, 256> source;
  std::iota(source.begin(), source.end(), 0);
  int64_t state = NextState(NextState(NextState(seed)));
  for (int i = 255; i >= 0; --i) {
    state = NextState(state);
    const int64_t remainder = (state % (i + 1) + 31) % (i + 1);
    const int64_t r = remainder < 0 ? remainder + i + 1 : remainder;
    permutation_[i] = source[r];
    source[r] = source[i];
  }
  for (size_t i = 0; i < gradients_.size(); ++i) gradients_[i] = PackedGradient(permutation_[i % 256] % 24);
}

NoisePlane::NoisePlane(const SimplexNoise& noise, const Area& area, double z) : z_(z) {
  // A cube's points reach from -1 to 2 beyond its origin; one more each way for rounding.
  const auto first = [](double coordinate) { return static_cast<int>(std::floor(coordinate)) - 2; };
  const auto last = [](double coordinate) { return static_cast<int>(std::floor(coordinate)) + 3; };
  const double stretch_low = (area.max_x + area.max_y + z) * kStretch;
  const double stretch_high = (area.min_x + area.min_y + z) * kStretch;
  min_i_ = first(area.min_x + (area.min_x + area.max_y + z) * kStretch);
  min_j_ = first(area.min_y + (area.max_x + area.min_y + z) * kStretch);
  min_k_ = first(z + stretch_low);
  const int max_i = last(area.max_x + (area.max_x + area.min_y + z) * kStretch);
  const int max_j = last(area.max_y + (area.min_x + area.max_y + z) * kStretch);
  stride_j_ = last(z + stretch_high) - min_k_ + 1;
  stride_i_ = (max_j - min_j_ + 1) * stride_j_;
  CRAFTFLEET_CHECK(stride_j_ <= 256);
  gradients_.resize(static_cast<size_t>(max_i - min_i_ + 1) * stride_i_);
  uint32_t* out = gradients_.data();
  for (int i = min_i_; i <= max_i; ++i) {
    for (int j = min_j_; j <= max_j; ++j) {
      const int row = noise.permutation_[(noise.permutation_[i & 255] + j) & 255];
      out = std::copy_n(&noise.gradients_[(row + min_k_) & 255], stride_j_, out);
    }
  }
}

void NoisePlane::Evaluate(absl::Span<const double> x, absl::Span<const double> y, absl::Span<double> out) const {
  CRAFTFLEET_CHECK(x.size() == out.size() && y.size() == out.size());
  const Lattice lattice = {gradients_.data(), stride_i_, stride_j_, min_i_ * stride_i_ + min_j_ * stride_j_ + min_k_};
  Block block;
  for (size_t begin = 0; begin < out.size(); begin += kBlock) {
    const int count = static_cast<int>(std::min<size_t>(kBlock, out.size() - begin));
    Locate(lattice, x.data() + begin, y.data() + begin, z_, count, &block);
    Classify(count, &block);
    std::fill_n(block.value, count, 0.0);
    for (const Corner& corner : kCorners) AddCorner(lattice, corner, count, &block);
    AddExtra(lattice, kExtras.first, count, &block);
    AddExtra(lattice, kExtras.second, count, &block);
    for (int n = 0; n < count; ++n) out[begin + n] = block.value[n] / kNorm;
  }
}

}  // namespace craftfleet
