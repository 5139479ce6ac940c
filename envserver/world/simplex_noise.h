// OpenSimplex noise in three dimensions, bit for bit that of the opensimplex package.
// Source: RULES.md, section 11.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_SIMPLEX_NOISE_H_
#define CRAFTFLEET_ENVSERVER_WORLD_SIMPLEX_NOISE_H_

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

#endif  // CRAFTFLEET_ENVSERVER_WORLD_SIMPLEX_NOISE_H_
