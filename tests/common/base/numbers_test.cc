#include "common/base/numbers.h"

#include <cstdint>
#include <limits>
#include <string>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(ExactNumber, ReadsBackTheSame) {
  EXPECT_EQ(ExactNumber(10.3), "10.3");
  EXPECT_EQ(ExactNumber(2), "2");
  EXPECT_EQ(std::stod(ExactNumber(1.0 / 3)), 1.0 / 3);
  for (const double value : {-1e-300, 1e300, std::numeric_limits<double>::min(), std::numeric_limits<double>::max()}) {
    EXPECT_EQ(std::stod(ExactNumber(value)), value) << ExactNumber(value);
  }
}

TEST(WithCommas, GroupsThousands) {
  EXPECT_EQ(WithCommas(0), "0");
  EXPECT_EQ(WithCommas(999), "999");
  EXPECT_EQ(WithCommas(1'000), "1,000");
  EXPECT_EQ(WithCommas(1'234'567), "1,234,567");
  EXPECT_EQ(WithCommas(-123), "-123");
  EXPECT_EQ(WithCommas(-1'234), "-1,234");
  EXPECT_EQ(WithCommas(std::numeric_limits<int64_t>::min()), "-9,223,372,036,854,775,808");
}

}  // namespace
}  // namespace craftfleet
