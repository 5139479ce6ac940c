// The seed of an episode's random stream.

#pragma once

#include <cstdint>

namespace craftfleet {

// hash((seed, episode)) of 64-bit CPython 3.8 and later, read as a signed number, mathematically modulo 2^31 - 1:
// 0..2^31-2. Seed 0 gives 1256191933 for episode 1. Modulo 2^64, with ^ for exclusive or:
//   lane(n) = sign(n) * (|n| mod (2^61 - 1)), with -1 replaced by -2
//   acc     = 2870177450012600261
//   for n in (seed, episode):
//     acc   = rotate_left(acc + lane(n) * 14029467366897019727, 31) * 11400714785074694791
//   acc    += 2 ^ (2870177450012600261 ^ 3527539);  if acc is 2^64 - 1: acc = 1546275796
uint32_t EpisodeSeed(int64_t seed, int64_t episode);

}  // namespace craftfleet
