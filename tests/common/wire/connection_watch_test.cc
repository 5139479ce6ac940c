#include "common/wire/connection_watch.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet::wire {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Key;
using testing::Pair;

constexpr ConnectionLimits kLimits = {10, 30, 1000, 3000};

TEST(FindFloods, LeavesConnectionsAtTheLimitsAlone) {
  EXPECT_THAT(FindFloods({{3, "a", 10, 1000}, {4, "a", 10, 1000}, {5, "a", 10, 1000}, {6, "b", 10, 1000}}, kLimits),
              IsEmpty());
}

TEST(FindFloods, EndsAConnectionWithTooManyStreamsOrBytes) {
  EXPECT_THAT(FindFloods({{3, "a", 11, 0}, {4, "a", 0, 1001}, {5, "a", 1, 1}}, kLimits),
              ElementsAre(Pair(3, HasSubstr("11 streams, want at most 10")),
                          Pair(4, HasSubstr("1001 bytes without a message, want at most 1000"))));
}

TEST(FindFloods, EndsTheLargestConnectionsOfAClientThatHasTooMuch) {
  EXPECT_THAT(FindFloods({{3, "a", 9, 0}, {4, "a", 10, 0}, {5, "a", 9, 0}, {6, "a", 3, 0}, {7, "b", 9, 0}}, kLimits),
              ElementsAre(Pair(4, HasSubstr("its client has 31 streams, want at most 30"))));
  EXPECT_THAT(FindFloods({{3, "a", 0, 999}, {4, "a", 0, 998}, {5, "a", 0, 1000}, {6, "a", 0, 4}}, kLimits),
              ElementsAre(Key(5)));
}

TEST(FindFloods, CountsWhatIsEndedAnywayOnce) {
  EXPECT_THAT(FindFloods({{3, "a", 100, 0}, {4, "a", 10, 0}, {5, "a", 10, 0}, {6, "a", 10, 0}}, kLimits),
              ElementsAre(Key(3)));
}

}  // namespace
}  // namespace craftfleet::wire
