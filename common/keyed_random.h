// Counter-based random numbers: each is a function of its key alone, so that whoever computes it, in whatever order,
// gets the same.

#ifndef CRAFTFLEET_COMMON_KEYED_RANDOM_H_
#define CRAFTFLEET_COMMON_KEYED_RANDOM_H_

#include <cstdint>
#include <initializer_list>

#include "common/seeds.h"

namespace craftfleet {

// What a number is used for: part of the key, so that two uses never share numbers.
enum class RandomUse : uint64_t {
  kActionNoise = 1,
  kMinibatchOrder = 2,
  kInitialWeights = 3,
  kDropout = 4,
};

// 64 random bits.
constexpr uint64_t KeyedBits(RandomUse use, uint64_t seed, uint64_t a, uint64_t b) {
  constexpr uint64_t kGamma = 0x9E3779B97F4A7C15ULL;
  uint64_t bits = MixBits(seed + kGamma * static_cast<uint64_t>(use));
  for (const uint64_t word : {a, b}) bits = MixBits(MixBits(bits + kGamma * (word + 1)));
  return bits;
}

// A double in [0, 1) from the top 53 bits.
constexpr double UnitInterval(uint64_t bits) { return static_cast<double>(bits >> 11) * 0x1p-53; }

// What draws the action of step `lane_step` (from 0, over all episodes and fragments) of `lane`: in [0, 1).
constexpr double ActionNoise(uint64_t run_seed, int lane, int64_t lane_step) {
  return UnitInterval(
      KeyedBits(RandomUse::kActionNoise, run_seed, static_cast<uint64_t>(lane), static_cast<uint64_t>(lane_step)));
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_KEYED_RANDOM_H_
