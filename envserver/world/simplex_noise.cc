#include "envserver/world/simplex_noise.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/check.h"
#include "common/multiversion.h"

namespace craftfleet {
namespace {

constexpr double kStretch = -1.0 / 6;
constexpr double kSquish = 1.0 / 3;
constexpr double kNorm = 103;

// Where in its skewed unit cube a point lies decides which lattice points count. A cube is cut by two planes.
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

// Two lattice points farther off count too; which, tells a case number. Their displacement is formed term by term,
// which matters for its last bit: minus the offset, minus squish * kSquish, minus `late`: hence late is kept apart, and
// the whole offset is offset + late. Packed, two bits each from the lowest: offset x y z plus 1, squish, late x y z.
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
};
// Sets of axes have the bits x 1, y 2, z 4. Cases: low region: the axes. High: 8 + axes. Middle: 16 + axes; where one
// pick lies on the far side and one on the near, 32 + far axes + 8 * near axis.
constexpr int kHighCase = 8;
constexpr int kMiddleCase = 16;
constexpr int kMixedCase = 32;
constexpr Extras MakeExtras() {
  Extras extras;
  extras.Set(1, Pack(1, -1, 0, 0), Pack(1, 0, -1, 0));
  extras.Set(2, Pack(-1, 1, 0, 0), Pack(0, 1, -1, 0));
  extras.Set(4, Pack(-1, 0, 1, 0), Pack(0, -1, 1, 0));
  extras.Set(3, Pack(1, 1, 0, 2), Pack(1, 1, -1, 1));
  extras.Set(5, Pack(1, 0, 1, 2), Pack(1, -1, 1, 1));
  extras.Set(6, Pack(0, 1, 1, 2), Pack(-1, 1, 1, 1));
  extras.Set(kHighCase + 3, Pack(2, 1, 0, 3), Pack(1, 1, 0, 3, 0, 1, 0));
  extras.Set(kHighCase + 5, Pack(2, 0, 1, 3), Pack(1, 0, 2, 3));
  extras.Set(kHighCase + 6, Pack(0, 1, 1, 3, 0, 1, 0), Pack(0, 1, 2, 3));
  extras.Set(kHighCase + 1, Pack(1, 0, 0, 1), Pack(2, 0, 0, 2));
  extras.Set(kHighCase + 2, Pack(0, 1, 0, 1), Pack(0, 2, 0, 2));
  extras.Set(kHighCase + 4, Pack(0, 0, 1, 1), Pack(0, 0, 2, 2));
  extras.Set(kMiddleCase + 1, Pack(1, 1, 1, 3), Pack(2, 0, 0, 2));
  extras.Set(kMiddleCase + 2, Pack(1, 1, 1, 3), Pack(0, 2, 0, 2));
  extras.Set(kMiddleCase + 4, Pack(1, 1, 1, 3), Pack(0, 0, 2, 2));
  extras.Set(kMiddleCase + 3, Pack(0, 0, 0, 0), Pack(1, 1, -1, 1));
  extras.Set(kMiddleCase + 5, Pack(0, 0, 0, 0), Pack(1, -1, 1, 1));
  extras.Set(kMiddleCase + 6, Pack(0, 0, 0, 0), Pack(-1, 1, 1, 1));
  extras.Set(kMixedCase + 3 + 0, Pack(1, 1, -1, 1), Pack(0, 0, 0, 2, 2, 0, 0));
  extras.Set(kMixedCase + 3 + 8, Pack(1, 1, -1, 1), Pack(0, 0, 0, 2, 0, 2, 0));
  extras.Set(kMixedCase + 5 + 0, Pack(1, -1, 1, 1), Pack(0, 0, 0, 2, 2, 0, 0));
  extras.Set(kMixedCase + 5 + 16, Pack(1, -1, 1, 1), Pack(0, 0, 0, 2, 0, 0, 2));
  extras.Set(kMixedCase + 6 + 8, Pack(-1, 1, 1, 1), Pack(0, 0, 0, 2, 0, 2, 0));
  extras.Set(kMixedCase + 6 + 16, Pack(-1, 1, 1, 1), Pack(0, 0, 0, 2, 0, 0, 2));
  return extras;
}
constexpr Extras kExtras = MakeExtras();

constexpr int kBlock = 64;  // points worked on at a time: their intermediate values stay in the first cache

// Intermediate values of the points, one array each so that loops over points vectorise.
struct Block {
  double x[kBlock], y[kBlock], z[kBlock];     // displacement from the cube's origin
  int32_t i[kBlock], j[kBlock], k[kBlock];    // the cube's origin in the lattice
  double fx[kBlock], fy[kBlock], fz[kBlock];  // place inside the skewed cube, 0..1
  int32_t region[kBlock];
  int32_t extras[kBlock];  // case number
  double value[kBlock];
};

// The axes that tell the case in the low region: of the two with the larger parts, the larger one when the origin is
// nearer
// (`origin`) than one of them, else both. All comparisons and selections, no branches. (`&` and `|` on purpose.)
inline int32_t LowAxes(double x, double y, double z, double origin) {
  const bool z_for_y = (x >= y) & (z > y);
  const bool z_for_x = (x < y) & (z > x);
  const double a = z_for_x ? z : x;
  const double b = z_for_y ? z : y;
  const int32_t a_axis = z_for_x ? 4 : 1;
  const int32_t b_axis = z_for_y ? 4 : 2;
  const int32_t larger = b > a ? b_axis : a_axis;
  return (origin > a) | (origin > b) ? larger : a_axis | b_axis;
}

// In the middle region there is a near axis and a far pair of axes for each of xy, xz, yz: by how much the pair's sum
// is away from 1 decides between pairs, its sign between near and far.
inline int32_t MiddleCase(double x, double y, double z) {
  const double xy = x + y - 1;
  const double xz = x + z - 1;
  const double yz = y + z - 1;
  const int32_t yz_axes = yz > 0 ? 6 : 1;
  const double a_size = std::abs(xy);
  const double b_size = std::abs(xz);
  const double c_size = std::abs(yz);
  const bool c_for_a = (a_size <= b_size) & (a_size < c_size);
  const bool c_for_b = (a_size > b_size) & (b_size < c_size);
  const int32_t a = c_for_a ? yz_axes : xy > 0 ? 3 : 4;
  const int32_t b = c_for_b ? yz_axes : xz > 0 ? 5 : 2;
  const bool a_far = (c_for_a ? yz : xy) > 0;
  const bool b_far = (c_for_b ? yz : xz) > 0;
  const int32_t same = kMiddleCase + (a_far ? a & b : a | b);
  const int32_t mixed = kMixedCase + (a_far ? a : b) + 8 * ((a_far ? b : a) >> 1);
  return a_far == b_far ? same : mixed;
}

CRAFTFLEET_MULTIVERSION void Locate(const double* x, const double* y, double z, int count, Block* block) {
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
    block->i[n] = static_cast<int32_t>(i);
    block->j[n] = static_cast<int32_t>(j);
    block->k[n] = static_cast<int32_t>(k);
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
    const bool low = sum <= 1;
    const bool high = sum >= 2;
    // The high region is the low one turned about.
    const int32_t axes = LowAxes(high ? -x : x, high ? -y : y, high ? -z : z, high ? sum - 3 : 1 - sum);
    const int32_t outer = high ? kHighCase + 7 - axes : axes;
    const int32_t middle = MiddleCase(x, y, z);
    block->region[n] = low ? kLow : high ? kHigh : kMiddle;
    block->extras[n] = low | high ? outer : middle;
  }
}

struct Tables {
  const int32_t* permutation;
  const int32_t* gradients;
};

// What a lattice point at (i, j, k) gives at the displacement (x, y, z).
inline double Contribution(const Tables& tables, int32_t i, int32_t j, int32_t k, double x, double y, double z) {
  int32_t index = tables.permutation[i & 255];
  index = tables.permutation[(index + j) & 255];
  const int32_t gradient = tables.gradients[(index + k) & 255];
  const double gx = static_cast<int8_t>(gradient);
  const double gy = static_cast<int8_t>(gradient >> 8);
  const double gz = static_cast<int8_t>(gradient >> 16);
  double attenuation = 2 - x * x - y * y - z * z;
  const bool counts = attenuation > 0;
  attenuation *= attenuation;
  const double contribution = attenuation * attenuation * (gx * x + gy * y + gz * z);
  return counts ? contribution : 0.0;
}

CRAFTFLEET_MULTIVERSION void AddCorner(const Tables& tables, const Corner& corner, int count, Block* block) {
  const double squish = (corner.i + corner.j + corner.k) * kSquish;
  for (int n = 0; n < count; ++n) {
    const double contribution =
        Contribution(tables, block->i[n] + corner.i, block->j[n] + corner.j, block->k[n] + corner.k,
                     block->x[n] - corner.i - squish, block->y[n] - corner.j - squish, block->z[n] - corner.k - squish);
    block->value[n] += (block->region[n] & corner.regions) != 0 ? contribution : 0.0;
  }
}

CRAFTFLEET_MULTIVERSION void AddExtra(const Tables& tables, const int32_t* points, int count, Block* block) {
  for (int n = 0; n < count; ++n) {
    const int32_t point = points[block->extras[n]];
    const int32_t i = (point & 3) - 1;
    const int32_t j = (point >> 2 & 3) - 1;
    const int32_t k = (point >> 4 & 3) - 1;
    const double squish = (point >> 6 & 3) * kSquish;
    const int32_t late_i = point >> 8 & 3;
    const int32_t late_j = point >> 10 & 3;
    const int32_t late_k = point >> 12 & 3;
    block->value[n] += Contribution(tables, block->i[n] + i + late_i, block->j[n] + j + late_j,
                                    block->k[n] + k + late_k, block->x[n] - i - squish - late_i,
                                    block->y[n] - j - squish - late_j, block->z[n] - k - squish - late_k);
  }
}

int64_t NextState(int64_t state) {
  return static_cast<int64_t>(static_cast<uint64_t>(state) * 6364136223846793005ULL + 1442695040888963407ULL);
}

// Components are 11 on one axis, 4 on the others; the sign of each axis is a bit of number / 3.
int32_t PackedGradient(int number) {
  constexpr int kSigns[8][3] = {{-1, 1, 1},  {1, 1, 1},  {-1, -1, 1},  {1, -1, 1},
                                {-1, 1, -1}, {1, 1, -1}, {-1, -1, -1}, {1, -1, -1}};
  uint32_t packed = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const int component = kSigns[number / 3][axis] * (number % 3 == axis ? 11 : 4);
    packed |= static_cast<uint32_t>(static_cast<uint8_t>(component)) << (8 * axis);
  }
  return static_cast<int32_t>(packed);
}

}  // namespace

SimplexNoise::SimplexNoise(int64_t seed) {
  std::array<int32_t, 256> source;
  std::iota(source.begin(), source.end(), 0);
  int64_t state = NextState(NextState(NextState(seed)));
  for (int i = 255; i >= 0; --i) {
    state = NextState(state);
    const int64_t remainder = (state % (i + 1) + 31) % (i + 1);
    const int64_t r = remainder < 0 ? remainder + i + 1 : remainder;
    permutation_[i] = source[r];
    source[r] = source[i];
    gradients_[i] = PackedGradient(permutation_[i] % 24);
  }
}

void SimplexNoise::Evaluate(absl::Span<const double> x, absl::Span<const double> y, double z,
                            absl::Span<double> out) const {
  CRAFTFLEET_CHECK(x.size() == out.size() && y.size() == out.size());
  const Tables tables = {permutation_.data(), gradients_.data()};
  Block block;
  for (size_t begin = 0; begin < out.size(); begin += kBlock) {
    const int count = static_cast<int>(std::min<size_t>(kBlock, out.size() - begin));
    Locate(x.data() + begin, y.data() + begin, z, count, &block);
    Classify(count, &block);
    std::fill_n(block.value, count, 0.0);
    for (const Corner& corner : kCorners) AddCorner(tables, corner, count, &block);
    AddExtra(tables, kExtras.first, count, &block);
    AddExtra(tables, kExtras.second, count, &block);
    for (int n = 0; n < count; ++n) out[begin + n] = block.value[n] / kNorm;
  }
}

}  // namespace craftfleet
