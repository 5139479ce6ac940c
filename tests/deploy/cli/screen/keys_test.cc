#include "deploy/cli/screen/keys.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

TEST(KeysFromTerminal, ReadsLettersAndArrowsOfBothModes) {
  EXPECT_THAT(KeysFromTerminal("wW \t1"), ElementsAre('w', 'w', ' ', kTabKey, '1'));
  EXPECT_THAT(KeysFromTerminal("\x1b[A\x1b[B\x1bOC\x1bODx"), ElementsAre(kUpKey, kDownKey, kRightKey, kLeftKey, 'x'));
}

TEST(KeysFromTerminal, KnowsEscapeAndCtrlC) {
  EXPECT_THAT(KeysFromTerminal("\x1b"), ElementsAre(kEscapeKey));
  EXPECT_THAT(KeysFromTerminal("\x03"), ElementsAre(kCloseKey));
}

TEST(KeysFromTerminal, SkipsWhatItDoesNotKnow) {
  EXPECT_THAT(KeysFromTerminal("\x1b[6~\x1b[1;5H"), IsEmpty());
  EXPECT_THAT(KeysFromTerminal("\x01\xc3\xa4q"), ElementsAre('q'));
  EXPECT_THAT(KeysFromTerminal("\x1b["), IsEmpty());
  EXPECT_THAT(KeysFromTerminal("\x1b[12"), IsEmpty());
}

TEST(KeysFromTerminal, ACtrlArrowIsAnArrow) { EXPECT_THAT(KeysFromTerminal("\x1b[1;5A"), ElementsAre(kUpKey)); }

TEST(KeyFromWindow, ReadsAsciiAndArrows) {
  EXPECT_EQ(KeyFromWindow('w'), 'w');
  EXPECT_EQ(KeyFromWindow('W'), 'w');
  EXPECT_EQ(KeyFromWindow(0xff51), kLeftKey);
  EXPECT_EQ(KeyFromWindow(0xff52), kUpKey);
  EXPECT_EQ(KeyFromWindow(0xff53), kRightKey);
  EXPECT_EQ(KeyFromWindow(0xff54), kDownKey);
  EXPECT_EQ(KeyFromWindow(9), kTabKey);
  EXPECT_EQ(KeyFromWindow(27), kEscapeKey);
}

TEST(KeyFromWindow, IgnoresModifiersAndOtherKeys) {
  EXPECT_EQ(KeyFromWindow(0x100000 | 'd'), 'd') << "Num Lock";
  EXPECT_EQ(KeyFromWindow(-1), kNoKey);
  EXPECT_EQ(KeyFromWindow(0xffe1), kNoKey) << "Shift";
}

}  // namespace
}  // namespace craftfleet
