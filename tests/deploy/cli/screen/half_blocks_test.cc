#include "deploy/cli/screen/half_blocks.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;

// Pixels of one digit each: "1" is the colour (1, 1, 1).
std::string Picture(absl::string_view digits) {
  std::string pixels;
  for (const char digit : digits) pixels += std::string(3, static_cast<char>(digit - '0'));
  return pixels;
}

TEST(HalfBlocks, PutsTwoRowsIntoALine) {
  EXPECT_THAT(HalfBlocks(Picture("12"
                                 "34"),
                         2, 2),
              ElementsAre("\x1b[38;2;1;1;1m\x1b[48;2;3;3;3m\u2580\x1b[38;2;2;2;2m\x1b[48;2;4;4;4m\u2580\x1b[0m"));
}

TEST(HalfBlocks, NamesAColorOnlyWhereItChanges) {
  EXPECT_THAT(HalfBlocks(Picture("112"
                                 "333"),
                         3, 2),
              ElementsAre("\x1b[38;2;1;1;1m\x1b[48;2;3;3;3m\u2580\u2580\x1b[38;2;2;2;2m\u2580\x1b[0m"));
}

TEST(HalfBlocks, AnOddHeightEndsInBlack) {
  EXPECT_THAT(HalfBlocks(Picture("123"), 1, 3), ElementsAre("\x1b[38;2;1;1;1m\x1b[48;2;2;2;2m\u2580\x1b[0m",
                                                            "\x1b[38;2;3;3;3m\x1b[48;2;0;0;0m\u2580\x1b[0m"));
}

TEST(HalfBlocks, ColorsAreUnsigned) {
  EXPECT_THAT(HalfBlocks(std::string("\xff\x80\x00", 3), 1, 1),
              ElementsAre("\x1b[38;2;255;128;0m\x1b[48;2;0;0;0m\u2580\x1b[0m"));
}

}  // namespace
}  // namespace craftfleet
