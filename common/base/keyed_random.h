// Counter-based random numbers: each is a function of its key alone, so that every process that computes it, in any
// order, gets the same.

#pragma once

#include <cstdint>
#include <initializer_list>

#include "common/base/seeds.h"

namespace craftfleet {

// The purpose of a number: part of the key, so that two purposes never share numbers.
enum class RandomUse : uint64_t {
  kActionNoise = 1,
  kMinibatchOrder = 2,
  kInitialWeights = 3,
  kDropout = 4,
  kDistillation = 5,
};

inline constexpr uint64_t kKeyedGamma = 0x9E3779B97F4A7C15ULL;

// The state of KeyedBits before its last word; takes in one more word.
constexpr uint64_t TakeInWord(uint64_t bits, uint64_t word) {
  return MixBits(MixBits(bits + kKeyedGamma * (word + 1)));
}
constexpr uint64_t KeyedBitsBeforeLast(RandomUse use, uint64_t seed, uint64_t a) {
  return TakeInWord(MixBits(seed + kKeyedGamma * static_cast<uint64_t>(use)), a);
}

// 64 random bits.
constexpr uint64_t KeyedBits(RandomUse use, uint64_t seed, uint64_t a, uint64_t b) {
  return TakeInWord(KeyedBitsBeforeLast(use, seed, a), b);
}

// A double in [0, 1) from the top 53 bits.
constexpr double UnitInterval(uint64_t bits) { return static_cast<double>(bits >> 11) * 0x1p-53; }

// The uniform number in [0, 1) that samples the action of step `lane_step` (from 0, over all episodes) of `lane`.
constexpr double ActionNoise(uint64_t run_seed, int lane, int64_t lane_step) {
  return UnitInterval(
      KeyedBits(RandomUse::kActionNoise, run_seed, static_cast<uint64_t>(lane), static_cast<uint64_t>(lane_step)));
}

}  // namespace craftfleet
