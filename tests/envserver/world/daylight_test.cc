#include "envserver/world/daylight.h"

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

// Values of the plain Python model.
TEST(Daylight, IsExact) {
  EXPECT_EQ(Daylight(0), 0.7969251898544335);
  EXPECT_EQ(Daylight(1), 0.8056125421622267);
  EXPECT_EQ(Daylight(150), 0.4704915028125265);
  EXPECT_EQ(Daylight(180), 0.13976129970551698);
  EXPECT_EQ(Daylight(240), 0.13976129970551665);
  EXPECT_EQ(Daylight(299), 0.7880515360143441);
  EXPECT_EQ(Daylight(9999), 0.9373592742624732);
}

TEST(Daylight, RisesAndFallsWithADayOf300Steps) {
  for (int step = 0; step < 10000; ++step) {
    const double light = Daylight(step);
    EXPECT_GE(light, 0);
    EXPECT_LE(light, 1);
    EXPECT_NEAR(light, Daylight(step + 300), 1e-12);  // not periodic in the last bits
  }
  EXPECT_EQ(Daylight(210), 0);
  EXPECT_EQ(Daylight(60), 1);
}

}  // namespace
}  // namespace craftfleet
