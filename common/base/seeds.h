// Seeds of a run's games, each derived from the run's seed and the lane's number alone; numbers of evaluation episodes.

#pragma once

#include <cstdint>

namespace craftfleet {

// The finaliser of splitmix64: a bijection in which every input bit changes about half of the output bits.
constexpr uint64_t MixBits(uint64_t x) {
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ULL;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBULL;
  return x ^ (x >> 31);
}

// Seed of the game on `lane`, 0..2^31-1.
constexpr int64_t LaneSeed(uint64_t run_seed, int lane) {
  constexpr uint64_t kGamma = 0x9E3779B97F4A7C15ULL;
  return static_cast<int64_t>(MixBits(MixBits(run_seed + kGamma) + kGamma * (static_cast<uint64_t>(lane) + 1)) >> 33);
}

// The episodes of an evaluation environment are 1..kLastEvaluationEpisode: actors use the number as the lane.
inline constexpr int64_t kLastEvaluationEpisode = 0x7FFFFFFF;
inline constexpr int kMaxEvaluationEpisodes = 10'000;  // of each kind in one evaluation: they fit one message

}  // namespace craftfleet
