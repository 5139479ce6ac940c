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

TEST(HalfBlocks, TerminalsWithFewerColorsGetTheNearest) {
  const std::string picture("\xff\x80\x00\x41\x40\x42", 6);
  EXPECT_THAT(HalfBlocks(picture, 1, 2, Colors::k256), ElementsAre("\x1b[38;5;208m\x1b[48;5;238m\u2580\x1b[0m"));
  EXPECT_THAT(HalfBlocks(picture, 1, 2, Colors::k16), ElementsAre("\x1b[33m\x1b[100m\u2580\x1b[0m"));
  EXPECT_THAT(HalfBlocks(std::string("\xff\xff\xff\x5c\x5c\xff", 6), 1, 2, Colors::k16),
              ElementsAre("\x1b[97m\x1b[104m\u2580\x1b[0m"));
  EXPECT_THAT(HalfBlocks(std::string(6, '\0'), 1, 2, Colors::k256),
              ElementsAre("\x1b[38;5;16m\x1b[48;5;16m\u2580\x1b[0m"));
}

TEST(Colors, AreThoseThatTheTerminalNames) {
  EXPECT_EQ(ColorsOf("truecolor", "xterm"), Colors::kTrue);
  EXPECT_EQ(ColorsOf("24bit", nullptr), Colors::kTrue);
  EXPECT_EQ(ColorsOf(nullptr, "xterm-direct"), Colors::kTrue);
  EXPECT_EQ(ColorsOf("", "screen-256color"), Colors::k256);
  EXPECT_EQ(ColorsOf(nullptr, "linux"), Colors::k16);
  EXPECT_EQ(ColorsOf("yes", nullptr), Colors::k16);
}

}  // namespace
}  // namespace craftfleet
