#include "envserver/world/episode_seed.h"

#include <cstdint>
#include <limits>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(EpisodeSeed, MatchesTheRulesPage) {
  EXPECT_EQ(EpisodeSeed(0, 1), 1256191933u);
  EXPECT_EQ(EpisodeSeed(0, 2), 744553801u);
  EXPECT_EQ(EpisodeSeed(1, 1), 535231920u);
}

// Values of hash((seed, episode)) % (2**31 - 1) in CPython 3.11.
TEST(EpisodeSeed, MatchesPythonForEverySignAndSize) {
  EXPECT_EQ(EpisodeSeed(-1, 1), 1476744201u);
  EXPECT_EQ(EpisodeSeed(-2, 1), 1476744201u);
  EXPECT_EQ(EpisodeSeed(-3, 7), 672708617u);
  EXPECT_EQ(EpisodeSeed(2305843009213693951, 3), 1246819891u);
  EXPECT_EQ(EpisodeSeed(2305843009213693950, 3), 1500367303u);
  EXPECT_EQ(EpisodeSeed(2305843009213693952, 3), 1639102990u);
  EXPECT_EQ(EpisodeSeed(-2305843009213693952, 5), 1358661231u);
  EXPECT_EQ(EpisodeSeed(9223372036854775807, 1099511627776), 1164045272u);
  EXPECT_EQ(EpisodeSeed(std::numeric_limits<int64_t>::min(), 1), 1981593938u);
  EXPECT_EQ(EpisodeSeed(-9223372036854775807, 2), 288525493u);
}

}  // namespace
}  // namespace craftfleet
