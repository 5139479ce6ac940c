// OpenSimplex noise in three dimensions, bit for bit that of the opensimplex package.
//
// Permutation: starts with the identity on 0..255. The state s = seed advances to s * 6364136223846793005 +
//   1442695040888963407 in wrapping signed 64-bit arithmetic, three times. Then for i = 255 down to 0: it advances
//   once; r = (s + 31) mod (i + 1), mathematical modulo, the sum not wrapping; p[i] = source[r]; source[r] =
//   source[i].
// Gradients: lattice point (i, j, k) has g = p[(p[(p[i & 255] + j) & 255] + k) & 255] mod 24. Its component on
//   axis g mod 3 is 11, those on the others 4; the signs for g div 3 = 0..7 are (- + +) (+ + +) (- - +) (+ - +) (- +
//   -) (+ + -) (- - -) (+ - -).
// Location: with t = (x + y + z) * (-1/6), the skewed point is (x + t, y + t, z + t), its floor (i, j, k), its
//   fractions (u, v, w). With q = (i + j + k) * (1/3), the displacement is (x - (i + q), y - (j + q), z - (k + q)).
// Contribution of a lattice point at displacement (dx, dy, dz): a = 2 - dx*dx - dy*dy - dz*dz, from left to right;
//   0 unless a > 0; else, with b = a * a, the value (b * b) * (gx*dx + gy*dy + gz*dz).
// Corners: with f = u + v + w, the first corner counts for f <= 1, those with one 1 for f < 2, those with two for
//   f > 1, the last for f >= 2; their order is that of kCorners (simplex_noise.cc).
// Extra points: two more follow from a case (MakeExtras, simplex_noise.cc).
//   - f <= 1: begin with A = (axis x, u) and B = (axis y, v). If u < v, z replaces A if w > u; otherwise z replaces B
//     if w > v. If 1 - f > min(A, B), the case is the axis of the larger (A if equal), else the two axes together.
//   - f >= 2: the same with -u, -v, -w and f - 3 in place of 1 - f.
//   - Between: the pairs xy, xz, yz have the values u+v-1, u+w-1, v+w-1. A positive value picks the pair, any other
//     the remaining axis. Two of the three picks count, those with the largest absolute values: if |xy| <= |xz|, the
//     picks of xz and of yz or xy, yz if |xy| < |yz|; otherwise those of xy and of xz or yz, yz if |xz| < |yz|.
// The noise is the sum of the contributions, corners first, then the two extra points, divided by 103. All in doubles,
// one rounding per operation.

#pragma once

#include <array>
#include <cstdint>

namespace craftfleet {

// The noise lies within this bound, as the sum of all lattice points' greatest contributions does (1.02).
inline constexpr double kNoiseBound = 1.1;
// The sum of contributions is divided by this.
inline constexpr double kNoiseNorm = 103;

// The tables of a seed. Immutable after construction.
class SimplexNoise {
 public:
  struct Gradient {
    int8_t x, y, z;
  };

  explicit SimplexNoise(int64_t seed);

  double At(double x, double y, double z) const;
  // Of the lattice point (i, j, k), which is at (i + q, j + q, k + q) with q = (i + j + k) / 3.
  const Gradient& GradientAt(int i, int j, int k) const { return gradients_[GradientNumber(i, j, k)]; }
  // Gradients by number, 0..255.
  int GradientNumber(int i, int j, int k) const { return (permutation_[(permutation_[i & 255] + j) & 255] + k) & 255; }
  const Gradient& GradientWithNumber(int number) const { return gradients_[number]; }

 private:
  // The skewed unit cube around a point: its origin in the lattice, and the point's displacement from there.
  struct Cube {
    int i, j, k;
    double x, y, z;
  };
  // Of the lattice point at a packed offset from the cube's origin (simplex_noise.cc).
  double Contribution(const Cube& cube, int packed) const;

  std::array<uint8_t, 256> permutation_;
  std::array<Gradient, 256> gradients_;  // of each permuted value
};

}  // namespace craftfleet
