#include "envserver/render/vignette.h"

#include <cmath>
#include <cstdint>
#include <cstring>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

// Distance in units in the last place of two positive doubles.
int64_t Ulps(double a, double b) {
  int64_t a_bits;
  int64_t b_bits;
  std::memcpy(&a_bits, &a, sizeof(a));
  std::memcpy(&b_bits, &b, sizeof(b));
  return std::abs(a_bits - b_bits);
}

// Expected values: 60-digit decimal arithmetic, rounded once.
TEST(Vignette, ExpIsCorrectlyRounded) {
  EXPECT_EQ(ExpOfMinus(0), 1);
  EXPECT_EQ(ExpOfMinus(0x1p-60), 1);
  EXPECT_EQ(ExpOfMinus(1), 0x1.78b56362cef38p-2);
  EXPECT_EQ(ExpOfMinus(4), 0x1.2c155b8213cf4p-6);
  // Where glibc 2.36 with FMA is one unit lower.
  EXPECT_EQ(ExpOfMinus(0x1.30469043b8d84p+0), 0x1.37f75dd987452p-2);
}

TEST(Vignette, ExpIsWithinOneUnitOfTheCLibrarys) {
  for (int i = 0; i <= 20000; ++i) {
    const double x = 4.0 * i / 20000;
    EXPECT_LE(Ulps(ExpOfMinus(x), std::exp(-x)), 1) << x;
  }
}

TEST(Vignette, CoversCornersAndLeavesTheMiddleClear) {
  const int width = 63;
  const int height = 49;
  const std::vector<double> cover = Vignette(width, height);
  ASSERT_EQ(cover.size(), static_cast<size_t>(width) * height);
  EXPECT_NEAR(cover[31 * height + 24], 0, 1e-15);
  EXPECT_EQ(cover[0], 1 - ExpOfMinus(4));
  EXPECT_EQ(cover.back(), cover[0]);
  EXPECT_EQ(cover[62 * height + 24], cover[0 * height + 24]);
  EXPECT_EQ(cover[31 * height], cover[31 * height + 48]);
}

}  // namespace
}  // namespace craftfleet
