// Numbers of the plain Python model, one or two of each kind. tests/data/own has many more.

#include <cstdint>
#include <limits>

#include <gtest/gtest.h>

#include "envserver/world/daylight.h"
#include "envserver/world/episode_seed.h"
#include "envserver/world/simplex_noise.h"

namespace craftfleet {
namespace {

TEST(SimplexNoise, MatchesOpenSimplexBitForBit) {
  EXPECT_EQ(SimplexNoise(12345).At(15.17864587452162, 36.6927541126764, 6.0), 0.5009552703374286);
  EXPECT_EQ(SimplexNoise(2147483645).At(-16.768099415438662, 0.5714285714285714, 7.0), -0.4599513855629876);
}

// hash((seed, episode)) % (2**31 - 1) in CPython, whose hash has a case of its own for -1.
TEST(EpisodeSeed, MatchesPythonForEverySignAndSize) {
  EXPECT_EQ(EpisodeSeed(0, 1), 1256191933U);
  EXPECT_EQ(EpisodeSeed(-1, 1), 1476744201U);
  EXPECT_EQ(EpisodeSeed(-2, 1), 1476744201U);
  EXPECT_EQ(EpisodeSeed(2305843009213693951, 3), 1246819891U);
  EXPECT_EQ(EpisodeSeed(9223372036854775807, 1099511627776), 1164045272U);
  EXPECT_EQ(EpisodeSeed(std::numeric_limits<int64_t>::min(), 1), 1981593938U);
}

TEST(Daylight, RisesAndFallsWithADayOf300Steps) {
  EXPECT_EQ(Daylight(150), 0.4704915028125265);
  EXPECT_EQ(Daylight(210), 0);
  EXPECT_EQ(Daylight(60), 1);
  for (int step = 0; step < 10000; ++step) {
    const double light = Daylight(step);
    EXPECT_GE(light, 0);
    EXPECT_LE(light, 1);
    EXPECT_NEAR(light, Daylight(step + 300), 1e-12);  // not periodic in the last bits
  }
}

}  // namespace
}  // namespace craftfleet
