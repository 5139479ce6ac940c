#include "envserver/world/random_stream.h"

#include <algorithm>

#include "common/base/check.h"
#include "common/base/multiversion.h"

namespace craftfleet {
namespace {

constexpr int kWords = RandomStream::kStateWords;
constexpr int kShift = 397;

uint32_t Mix(uint32_t upper, uint32_t lower) {
  const uint32_t y = (upper & 0x80000000u) | (lower & 0x7fffffffu);
  return (y >> 1) ^ ((y & 1u) != 0 ? 0x9908b0dfu : 0u);
}

uint32_t Temper(uint32_t y) {
  y ^= y >> 11;
  y ^= (y << 7) & 0x9d2c5680u;
  y ^= (y << 15) & 0xefc60000u;
  return y ^ (y >> 18);
}

// Two words to a double with 53 random bits. Both parts are below 2^31, and signed conversion is the one that SIMD has.
double ToDouble(uint32_t high, uint32_t low) {
  const double a = static_cast<int32_t>(high >> 5);
  const double b = static_cast<int32_t>(low >> 6);
  return (a * 67108864.0 + b) * (1.0 / 9007199254740992.0);
}

// The next 624 words. In loops whose iterations are independent over any vector's width.
CRAFTFLEET_MULTIVERSION void Twist(uint32_t* words) {
  for (int i = 0; i < kWords - kShift; ++i) words[i] = words[i + kShift] ^ Mix(words[i], words[i + 1]);
  for (int i = kWords - kShift; i < kWords - 1; ++i) {
    words[i] = words[i + kShift - kWords] ^ Mix(words[i], words[i + 1]);
  }
  words[kWords - 1] = words[kShift - 1] ^ Mix(words[kWords - 1], words[0]);
}

// words[2 * count] to out[count].
CRAFTFLEET_MULTIVERSION void WordsToDoubles(const uint32_t* words, int count, double* out) {
  uint32_t tempered[kWords];
  for (int i = 0; i < 2 * count; ++i) tempered[i] = Temper(words[i]);
  for (int i = 0; i < count; ++i) out[i] = ToDouble(tempered[2 * i], tempered[2 * i + 1]);
}

}  // namespace

RandomStream::RandomStream(uint32_t seed) : position_(kStateWords) {
  words_[0] = seed;
  for (int i = 1; i < kStateWords; ++i) {
    words_[i] = 1812433253u * (words_[i - 1] ^ (words_[i - 1] >> 30)) + static_cast<uint32_t>(i);
  }
}

uint32_t RandomStream::Next() {
  if (position_ == kStateWords) {
    Twist(words_.data());
    position_ = 0;
  }
  return Temper(words_[position_++]);
}

double RandomStream::Uniform() {
  const uint32_t high = Next();
  return ToDouble(high, Next());
}

void RandomStream::FillUniform(absl::Span<double> out) {
  while (!out.empty()) {
    const int count = std::min<int>((kStateWords - position_) / 2, out.size());
    if (count == 0) {
      out[0] = Uniform();  // the block is used up, or one word of it is left
      out.remove_prefix(1);
      continue;
    }
    WordsToDoubles(words_.data() + position_, count, out.data());
    position_ += 2 * count;
    out.remove_prefix(count);
  }
}

uint32_t RandomStream::Below(uint32_t n) {
  const uint32_t last = n - 1;
  if (last == 0) return 0;
  uint32_t mask = last;
  for (int shift = 1; shift < 32; shift *= 2) mask |= mask >> shift;
  while (true) {
    const uint32_t value = Next() & mask;
    if (value <= last) return value;
  }
}

void RandomStream::Restore(const State& words, int position) {
  CRAFTFLEET_CHECK(position >= 0 && position <= kStateWords);
  words_ = words;
  position_ = position;
}

}  // namespace craftfleet
