#include "common/crc32c.h"

#include <string>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(Crc32c, GivesTheCheckValueOfItsDefinition) { EXPECT_EQ(Crc32c("123456789"), 0xE3069283U); }

// RFC 3720, appendix B.4.
TEST(Crc32c, GivesTheVectorsOfTheIscsiStandard) {
  EXPECT_EQ(Crc32c(std::string(32, '\0')), 0x8A9136AAU);
  EXPECT_EQ(Crc32c(std::string(32, '\xFF')), 0x62A8AB43U);
  std::string rising;
  for (char c = 0; c < 32; ++c) rising.push_back(c);
  EXPECT_EQ(Crc32c(rising), 0x46DD794EU);
  EXPECT_EQ(Crc32c(std::string(rising.rbegin(), rising.rend())), 0x113FDB5CU);
}

TEST(Crc32c, OfNothingIsZero) { EXPECT_EQ(Crc32c(""), 0U); }

}  // namespace
}  // namespace craftfleet
