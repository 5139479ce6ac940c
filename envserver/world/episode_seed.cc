#include "envserver/world/episode_seed.h"

namespace craftfleet {
namespace {

constexpr uint64_t kPrime1 = 11400714785074694791ULL;
constexpr uint64_t kPrime2 = 14029467366897019727ULL;
constexpr uint64_t kPrime5 = 2870177450012600261ULL;

// CPython's hash of an int, as the unsigned lane of a tuple's hash.
uint64_t HashInt(int64_t n) {
  const uint64_t magnitude = n < 0 ? 0 - static_cast<uint64_t>(n) : static_cast<uint64_t>(n);
  const uint64_t hash = magnitude % ((uint64_t{1} << 61) - 1);
  if (n >= 0) return hash;
  return hash == 1 ? static_cast<uint64_t>(-2) : 0 - hash;
}

uint64_t AddLane(uint64_t accumulator, uint64_t lane) {
  accumulator += lane * kPrime2;
  accumulator = (accumulator << 31) | (accumulator >> 33);
  return accumulator * kPrime1;
}

}  // namespace

uint32_t EpisodeSeed(int64_t seed, int64_t episode) {
  uint64_t hash = AddLane(AddLane(kPrime5, HashInt(seed)), HashInt(episode));
  hash += 2 ^ (kPrime5 ^ 3527539);
  if (hash == ~uint64_t{0}) hash = 1546275796;
  constexpr int64_t kModulus = (int64_t{1} << 31) - 1;
  const int64_t remainder = static_cast<int64_t>(hash) % kModulus;
  return static_cast<uint32_t>(remainder < 0 ? remainder + kModulus : remainder);
}

}  // namespace craftfleet
