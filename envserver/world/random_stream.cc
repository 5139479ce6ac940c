#include "envserver/world/random_stream.h"

#include <algorithm>

#include "common/base/check.h"
#include "common/base/cpu_path.h"

namespace craftfleet {
namespace {

constexpr int kWords = RandomStream::kStateWords;
constexpr int kShift = 397;

uint32_t Mix(uint32_t upper, uint32_t lower) {
  const uint32_t y = (upper & 0x80000000u) | (lower & 0x7fffffffu);
  return (y >> 1) ^ ((y & 1u) != 0 ? 0x9908b0dfu : 0u);
}

// The next 624 words. In loops whose iterations are independent over any vector's width.
CRAFTFLEET_KERNEL_BODY void TwistBody(uint32_t* words) {
  for (int i = 0; i < kWords - kShift; ++i) words[i] = words[i + kShift] ^ Mix(words[i], words[i + 1]);
  for (int i = kWords - kShift; i < kWords - 1; ++i) {
    words[i] = words[i + kShift - kWords] ^ Mix(words[i], words[i + 1]);
  }
  words[kWords - 1] = words[kShift - 1] ^ Mix(words[kWords - 1], words[0]);
}
CRAFTFLEET_KERNEL(Twist, TwistBody)

// words[2 * count] to high[count], tempered, and low[count].
CRAFTFLEET_KERNEL_BODY void SplitWordsBody(const uint32_t* __restrict words, int count, uint32_t* __restrict high,
                                           uint32_t* __restrict low) {
  for (int i = 0; i < count; ++i) {
    high[i] = internal::Temper(words[2 * i]);
    low[i] = words[2 * i + 1];
  }
}
CRAFTFLEET_KERNEL(SplitWords, SplitWordsBody)

}  // namespace

RandomStream::RandomStream(uint32_t seed) : position_(kStateWords) {
  words_[0] = seed;
  for (int i = 1; i < kStateWords; ++i) {
    words_[i] = 1812433253u * (words_[i - 1] ^ (words_[i - 1] >> 30)) + static_cast<uint32_t>(i);
  }
}

void RandomStream::NextBlock() {
  Twist(words_.data());
  position_ = 0;
  ++blocks_;
}

void RandomStream::Skip(int64_t words) {
  for (; words > kStateWords - position_; NextBlock()) words -= kStateWords - position_;
  position_ += static_cast<int>(words);
}

void RandomStream::FillWords(absl::Span<uint32_t> high, absl::Span<uint32_t> low) {
  while (!high.empty()) {
    int count = std::min<int>((kStateWords - position_) / 2, high.size());
    if (count > 0) {
      SplitWords(words_.data() + position_, count, high.data(), low.data());
      position_ += 2 * count;
    } else {  // the block is used up, or one word of it is left
      count = 1;
      high[0] = Next();
      if (position_ == kStateWords) NextBlock();
      low[0] = words_[position_++];
    }
    high.remove_prefix(count);
    low.remove_prefix(count);
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
