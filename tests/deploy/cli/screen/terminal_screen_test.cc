#include "deploy/cli/screen/terminal_screen.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::EndsWith;
using testing::HasSubstr;
using testing::SizeIs;

View Grey(int width, int height, std::vector<TextLine> lines) {
  return {width, height, std::string(size_t{3} * width * height, '\x40'), std::move(lines)};
}

constexpr char kGreyLine[] = "\x1b[38;2;64;64;64m\x1b[48;2;64;64;64m\u2580\u2580\x1b[0m";

TEST(PageRows, PutTextBesideThePictureAndBelowIt) {
  const auto rows = PageRows(Grey(2, 4, {{"one"}, {"two"}, {"three", TextLine::Style::kGood}}), 40, 4);
  ASSERT_THAT(rows, SizeIs(4));
  EXPECT_EQ(rows[0], std::string(kGreyLine) + "  one");
  EXPECT_EQ(rows[1], std::string(kGreyLine) + "  two");
  EXPECT_EQ(rows[2], "    \x1b[32mthree\x1b[0m");
  EXPECT_EQ(rows[3], "  ");
}

TEST(PageRows, CutWhatDoesNotFit) {
  const auto rows = PageRows(Grey(2, 8, {{"0123456789"}, {"b"}, {"c"}}), 8, 2);
  ASSERT_THAT(rows, SizeIs(2));
  EXPECT_THAT(rows[0], EndsWith("  0123"));
  EXPECT_THAT(PageRows(Grey(9, 2, {{"text"}}), 8, 1)[0], Not(HasSubstr("text")));
}

TEST(PageRows, ABarIsOfCharacters) {
  const View view = Grey(2, 2, {{"do", TextLine::Style::kPlain, 0.5}});
  EXPECT_THAT(PageRows(view, 80, 1)[0], EndsWith("  do                   ####      50%"));
}

}  // namespace
}  // namespace craftfleet
