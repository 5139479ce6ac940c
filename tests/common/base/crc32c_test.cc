#include "common/base/crc32c.h"

#include <string>

#include <gtest/gtest.h>

namespace craftfleet {
namespace {

TEST(Crc32c, MatchesTheCheckValue) { EXPECT_EQ(Crc32c("123456789"), 0xE3069283U); }

// RFC 3720, appendix B.4.
TEST(Crc32c, MatchesTheVectorsOfRfc3720) {
  EXPECT_EQ(Crc32c(std::string(32, '\0')), 0x8A9136AAU);
  EXPECT_EQ(Crc32c(std::string(32, '\xFF')), 0x62A8AB43U);
  std::string rising;
  for (char c = 0; c < 32; ++c) rising.push_back(c);
  EXPECT_EQ(Crc32c(rising), 0x46DD794EU);
  EXPECT_EQ(Crc32c(std::string(rising.rbegin(), rising.rend())), 0x113FDB5CU);
}

// Bit by bit, as the polynomial says.
uint32_t SlowCrc32c(const std::string& bytes) {
  uint32_t crc = 0xFFFFFFFF;
  for (const char byte : bytes) {
    crc ^= static_cast<uint8_t>(byte);
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0x82F63B78 : 0);
  }
  return ~crc;
}

TEST(Crc32c, MatchesTheDefinitionAtEveryLength) {
  std::string bytes;
  for (int length = 0; length < 100; ++length) {
    EXPECT_EQ(Crc32c(bytes), SlowCrc32c(bytes)) << length;
    bytes.push_back(static_cast<char>(length * 37 + 11));
  }
}

TEST(Crc32c, OfEmptyInputIsZero) { EXPECT_EQ(Crc32c(""), 0U); }

}  // namespace
}  // namespace craftfleet
