#include "envserver/world/simplex_noise.h"

#include <cmath>
#include <numeric>

namespace craftfleet {
namespace {

constexpr double kStretch = -1.0 / 6;
constexpr double kSquish = 1.0 / 3;

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

// The axes that determine the case in the low region: of the two axes with the larger parts, the larger one if `origin`
// exceeds the smaller part, else both.
int LowAxes(double x, double y, double z, double origin) {
  double a = x;
  double b = y;
  int a_axis = 1;
  int b_axis = 2;
  if (x < y) {
    if (z > x) {
      a = z;
      a_axis = 4;
    }
  } else if (z > y) {
    b = z;
    b_axis = 4;
  }
  if (origin > (a < b ? a : b)) return b > a ? b_axis : a_axis;
  return a_axis + b_axis;
}

// In the middle region each of xy, xz, yz has a far pick, the two axes, and a near one, the third axis: the sign of the
// pair's sum, less 1, decides. The two picks that count are those of the two sums farthest from 0.
int MiddleCase(double x, double y, double z) {
  const double xy = x + y - 1;
  const double xz = x + z - 1;
  const double yz = y + z - 1;
  const double xy_size = std::abs(xy);
  const double xz_size = std::abs(xz);
  const double yz_size = std::abs(yz);
  const int xy_pick = xy > 0 ? 3 : 4;
  const int xz_pick = xz > 0 ? 5 : 2;
  const int yz_pick = yz > 0 ? 6 : 1;
  if (xy_size <= xz_size) return 8 * (xy_size < yz_size ? yz_pick : xy_pick) + xz_pick;
  return 8 * xy_pick + (xz_size < yz_size ? yz_pick : xz_pick);
}

int64_t NextState(int64_t state) {
  return static_cast<int64_t>(static_cast<uint64_t>(state) * 6364136223846793005ULL + 1442695040888963407ULL);
}

// Components are 11 on one axis, 4 on the others; the sign of each axis is a bit of number / 3.
SimplexNoise::Gradient MakeGradient(int number) {
  constexpr int8_t kSigns[8][3] = {{-1, 1, 1},  {1, 1, 1},  {-1, -1, 1},  {1, -1, 1},
                                   {-1, 1, -1}, {1, 1, -1}, {-1, -1, -1}, {1, -1, -1}};
  const auto component = [&](int axis) {
    return static_cast<int8_t>(kSigns[number / 3][axis] * (number % 3 == axis ? 11 : 4));
  };
  return {component(0), component(1), component(2)};
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
  for (size_t i = 0; i < gradients_.size(); ++i) gradients_[i] = MakeGradient(permutation_[i] % 24);
}

double SimplexNoise::At(double x, double y, double z) const {
  const double stretch = (x + y + z) * kStretch;
  const double sx = x + stretch;
  const double sy = y + stretch;
  const double sz = z + stretch;
  const double i = std::floor(sx);
  const double j = std::floor(sy);
  const double k = std::floor(sz);
  const double squish = (i + j + k) * kSquish;
  const Cube cube = {static_cast<int>(i), static_cast<int>(j), static_cast<int>(k),
                     x - (i + squish),    y - (j + squish),    z - (k + squish)};
  const double fx = sx - i;
  const double fy = sy - j;
  const double fz = sz - k;
  const double sum = fx + fy + fz;
  Region region = kMiddle;
  int extras;
  if (sum <= 1) {
    region = kLow;
    extras = LowAxes(fx, fy, fz, 1 - sum);
  } else if (sum >= 2) {
    region = kHigh;  // the low one mirrored
    extras = kHighCase + LowAxes(-fx, -fy, -fz, sum - 3);
  } else {
    extras = MiddleCase(fx, fy, fz);
  }
  double value = 0;
  for (const Corner& corner : kCorners) {
    if ((corner.regions & region) != 0)
      value += Contribution(cube, Pack(corner.i, corner.j, corner.k, corner.i + corner.j + corner.k));
  }
  value += Contribution(cube, kExtras.first[extras]);
  value += Contribution(cube, kExtras.second[extras]);
  return value / kNoiseNorm;
}

double SimplexNoise::Contribution(const Cube& cube, int packed) const {
  const int i = (packed & 3) - 1;
  const int j = (packed >> 2 & 3) - 1;
  const int k = (packed >> 4 & 3) - 1;
  const double squish = (packed >> 6 & 3) * kSquish;
  const int late_i = packed >> 8 & 3;
  const int late_j = packed >> 10 & 3;
  const int late_k = packed >> 12 & 3;
  const double x = cube.x - i - squish - late_i;
  const double y = cube.y - j - squish - late_j;
  const double z = cube.z - k - squish - late_k;
  double attenuation = 2 - x * x - y * y - z * z;
  if (attenuation <= 0) return 0;
  attenuation *= attenuation;
  const Gradient& gradient = GradientAt(cube.i + i + late_i, cube.j + j + late_j, cube.k + k + late_k);
  return attenuation * attenuation * (gradient.x * x + gradient.y * y + gradient.z * z);
}

}  // namespace craftfleet
