// OpenSimplex noise in three dimensions, bit for bit that of the opensimplex package, on planes of constant z.
// Source: RULES.md, section 11.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_SIMPLEX_NOISE_H_
#define CRAFTFLEET_ENVSERVER_WORLD_SIMPLEX_NOISE_H_

#include <array>
#include <cstdint>
#include <vector>

#include <absl/types/span.h>

namespace craftfleet {

// The noise lies within this bound, as the sum of all lattice points' greatest contributions does (1.02).
inline constexpr double kNoiseBound = 1.1;

// The tables of a seed. Immutable after construction.
class SimplexNoise {
 public:
  explicit SimplexNoise(int64_t seed);

 private:
  friend class NoisePlane;

  std::array<uint8_t, 256> permutation_;
  std::array<uint32_t, 512> gradients_;  // of each permuted value, three signed bytes, x lowest; twice in a row
};

// The noise in a rectangle at one z. Immutable after construction.
class NoisePlane {
 public:
  struct Area {
    double min_x, max_x;
    double min_y, max_y;
  };

  // Time and memory grow with the area: 4 bytes a lattice point. At most a thousand units in each direction.
  NoisePlane(const SimplexNoise& noise, const Area& area, double z);

  // out[n] = noise at (x[n], y[n], z), all inside the area. Many points at a time are much faster.
  void Evaluate(absl::Span<const double> x, absl::Span<const double> y, absl::Span<double> out) const;

 private:
  const double z_;
  int min_i_, min_j_, min_k_;        // of the lattice points in reach
  int stride_i_, stride_j_;          // in gradients_
  std::vector<uint32_t> gradients_;  // [i][j][k]
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_SIMPLEX_NOISE_H_
