// The random stream of one episode: MT19937, seeded by init_genrand and read as numpy's RandomState reads it with
// uniform() and randint(0, n). The order of draws is part of the rules. Thread-compatible: one thread at a time.

#pragma once

#include <array>
#include <cstdint>

#include <absl/types/span.h>

namespace craftfleet {

namespace internal {
inline uint32_t Temper(uint32_t y) {
  y ^= y >> 11;
  y ^= (y << 7) & 0x9d2c5680u;
  y ^= (y << 15) & 0xefc60000u;
  return y ^ (y >> 18);
}
// Two words to a double with 53 random bits. Both parts are below 2^31, and signed conversion is the one that SIMD
// has.
inline double ToDouble(uint32_t high, uint32_t low) {
  const double a = static_cast<int32_t>(high >> 5);
  const double b = static_cast<int32_t>(low >> 6);
  return (a * 67108864.0 + b) * (1.0 / 9007199254740992.0);
}
}  // namespace internal

class RandomStream {
 public:
  static constexpr int kStateWords = 624;
  using State = std::array<uint32_t, kStateWords>;

  explicit RandomStream(uint32_t seed = 0);

  // One double in [0, 1): two words.
  double Uniform() {
    const uint32_t high = Next();
    return internal::ToDouble(high, Next());
  }
  // Draws `words` words (0 or more), two for each double, and drops them.
  void Skip(int64_t words);
  // Draws high.size() doubles as words: UniformOf(high[i], low[i]) is the double that call i of Uniform() would give.
  // For a caller that rarely needs all bits of a double. Equal sizes.
  void FillWords(absl::Span<uint32_t> high, absl::Span<uint32_t> low);
  // `high` is tempered already, `low` is not: so many callers do not need it.
  static double UniformOf(uint32_t high, uint32_t low) { return internal::ToDouble(high, internal::Temper(low)); }
  // One integer in [0, n), n in 1..2^32-1: no word for n = 1, else words until one, masked to the bits of n - 1, is at
  // most n - 1.
  uint32_t Below(uint32_t n);

  // For snapshots and traces: the words, and the number of used ones, 0..624 (624: the next draw twists first).
  // Restore aborts if `position` is out of range.
  const State& state() const { return words_; }
  int position() const { return position_; }
  void Restore(const State& words, int position);
  // The words drawn since a number that Restore and the constructor set: the difference of two calls counts the draws
  // in between.
  int64_t drawn() const { return blocks_ * kStateWords + position_; }

 private:
  uint32_t Next() {
    if (position_ == kStateWords) NextBlock();
    return internal::Temper(words_[position_++]);
  }
  void NextBlock();

  State words_;
  int position_;
  int64_t blocks_ = 0;  // made since the constructor
};

}  // namespace craftfleet
