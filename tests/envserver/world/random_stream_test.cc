#include "envserver/world/random_stream.h"

#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "tests/fakes/cpu_paths.h"

namespace craftfleet {
namespace {

// numpy.random.RandomState(seed).uniform(): first values.
TEST(RandomStream, MatchesNumpysFirstDoubles) {
  RandomStream zero(0);
  EXPECT_EQ(zero.Uniform(), 0.5488135039273248);
  EXPECT_EQ(zero.Uniform(), 0.7151893663724195);
  EXPECT_EQ(RandomStream(1).Uniform(), 0.417022004702574);
  EXPECT_EQ(RandomStream(42).Uniform(), 0.3745401188473625);
}

TEST(RandomStream, MakesADoubleFromTwoWords) {
  RandomStream stream(7);
  std::mt19937 words(7);
  for (int i = 0; i < 5000; ++i) {
    const uint64_t high = words() >> 5;
    const uint64_t low = words() >> 6;
    ASSERT_EQ(stream.Uniform(), static_cast<double>(high << 26 | low) / 9007199254740992.0) << i;
  }
}

class RandomStreamOnEachCpu : public OnEachCpuPath {};
CRAFTFLEET_ON_EACH_CPU_PATH(RandomStreamOnEachCpu);

TEST_P(RandomStreamOnEachCpu, FillingEqualsRepeatedUniformAtEveryOffset) {
  for (int offset = 0; offset <= 1250; ++offset) {
    for (const int count : {0, 1, 2, 17, 311, 312, 313, 700}) {
      RandomStream one_by_one(offset);
      for (int i = 0; i < offset; ++i) one_by_one.Below(2);
      RandomStream at_once = one_by_one;
      std::vector<uint32_t> high(count);
      std::vector<uint32_t> low(count);
      at_once.FillWords(absl::MakeSpan(high), absl::MakeSpan(low));
      for (int i = 0; i < count; ++i) {
        const double wanted = one_by_one.Uniform();
        ASSERT_EQ(RandomStream::UniformOf(high[i], low[i]), wanted) << offset << " " << count << " " << i;
      }
      ASSERT_EQ(at_once.position(), one_by_one.position());
      ASSERT_EQ(at_once.state(), one_by_one.state());
    }
  }
}

TEST(RandomStream, SkipEqualsDrawingAtEveryOffset) {
  for (int offset = 0; offset <= 1250; ++offset) {
    for (const int words : {0, 1, 623, 624, 625, 1248, 5000}) {
      RandomStream one_by_one(offset);
      for (int i = 0; i < offset; ++i) one_by_one.Below(2);
      RandomStream at_once = one_by_one;
      const int64_t before = at_once.drawn();
      at_once.Skip(words);
      EXPECT_EQ(at_once.drawn() - before, words);
      for (int i = 0; i < words; ++i) one_by_one.Below(2);
      EXPECT_EQ(one_by_one.drawn(), at_once.drawn());
      ASSERT_EQ(at_once.position(), one_by_one.position());
      ASSERT_EQ(at_once.state(), one_by_one.state());
    }
  }
}

// Below masks each word to the bits of n - 1 and takes another word if the value is too large.
TEST(RandomStream, BelowUsesOneWordPerTry) {
  for (const uint32_t n : {2u, 3u, 4u, 5u, 17u, 256u, 257u, 2147483647u, 2147483649u, 4294967295u}) {
    RandomStream stream(n);
    std::mt19937 words(n);
    uint32_t mask = 1;
    while (mask < n - 1) mask = mask << 1 | 1;
    for (int i = 0; i < 1000; ++i) {
      uint32_t expected;
      do {
        expected = words() & mask;
      } while (expected >= n);
      ASSERT_EQ(stream.Below(n), expected) << n;
    }
  }
}

TEST(RandomStream, BelowOneDrawsNothing) {
  RandomStream stream(3);
  stream.Uniform();
  EXPECT_EQ(stream.Below(1), 0u);
  EXPECT_EQ(stream.position(), 2);
}

TEST(RandomStream, TwistHappensAtTheNextDraw) {
  RandomStream stream(9);
  EXPECT_EQ(stream.position(), 624);
  for (int i = 0; i < 312; ++i) stream.Uniform();
  EXPECT_EQ(stream.position(), 624);
  stream.Uniform();
  EXPECT_EQ(stream.position(), 2);
}

TEST(RandomStreamDeathTest, RestoreRefusesAPositionPastTheEnd) {
  RandomStream stream;
  EXPECT_DEATH(stream.Restore(RandomStream(1).state(), 625), "broken invariant");
}

}  // namespace
}  // namespace craftfleet
