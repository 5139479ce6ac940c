// OpenSimplex noise in three dimensions, bit for bit that of the opensimplex package.
// Source: determinism page, section 6.

#ifndef CRAFTFLEET_ENVSERVER_WORLD_SIMPLEX_NOISE_H_
#define CRAFTFLEET_ENVSERVER_WORLD_SIMPLEX_NOISE_H_

#include <array>
#include <cstdint>

#include <absl/types/span.h>

namespace craftfleet {

// Immutable after construction: any number of threads.
class SimplexNoise {
 public:
  explicit SimplexNoise(int64_t seed);

  // out[n] = noise at (x[n], y[n], z), about -0.9..0.9. Coordinates within +-2^30. Many points at a time are much
  // faster.
  void Evaluate(absl::Span<const double> x, absl::Span<const double> y, double z, absl::Span<double> out) const;

 private:
  std::array<int32_t, 256> permutation_;  // 0..255
  std::array<int32_t, 256> gradients_;    // of each permuted value, three signed bytes: x lowest
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ENVSERVER_WORLD_SIMPLEX_NOISE_H_
