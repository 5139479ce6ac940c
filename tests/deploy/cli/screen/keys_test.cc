#include "deploy/cli/screen/keys.h"

#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace craftfleet {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

// The keys in `bytes`, and a '?' if some of them are left for the next read.
std::vector<Key> KeysIn(std::string bytes) {
  std::vector<Key> keys = TakeKeys(&bytes);
  if (!bytes.empty()) keys.push_back('?');
  return keys;
}

TEST(TakeKeys, ReadsLettersAndArrowsOfBothModes) {
  EXPECT_THAT(KeysIn("wW \t1"), ElementsAre('w', 'w', ' ', kTabKey, '1'));
  EXPECT_THAT(KeysIn("\x1b[A\x1b[B\x1bOC\x1bODx"), ElementsAre(kUpKey, kDownKey, kRightKey, kLeftKey, 'x'));
}

TEST(TakeKeys, KnowsEscapeAndCtrlC) {
  EXPECT_THAT(KeysIn("\x1b\x1b[A"), ElementsAre(kEscapeKey, kUpKey));
  EXPECT_THAT(KeysIn("\x03"), ElementsAre(kCloseKey));
}

TEST(TakeKeys, SkipsWhatItDoesNotKnow) {
  EXPECT_THAT(KeysIn("\x1b[6~\x1b[1;5H"), IsEmpty());
  EXPECT_THAT(KeysIn("\x01\xc3\xa4q"), ElementsAre('q'));
  EXPECT_THAT(KeysIn("\x1b[[Aq"), ElementsAre('q')) << "F1 on the console of Linux";
  EXPECT_THAT(KeysIn("\x1b[["), ElementsAre('?'));
}

TEST(TakeKeys, ACtrlArrowIsAnArrow) { EXPECT_THAT(KeysIn("\x1b[1;5A"), ElementsAre(kUpKey)); }

TEST(TakeKeys, AnArrowMayArriveInParts) {
  const std::string arrow = "\x1b[1;5A";
  for (size_t size = 1; size < arrow.size(); ++size) {
    std::string bytes = "q" + arrow.substr(0, size);
    EXPECT_THAT(TakeKeys(&bytes), ElementsAre('q'));
    bytes += arrow.substr(size);
    EXPECT_THAT(TakeKeys(&bytes), ElementsAre(kUpKey)) << size;
    EXPECT_EQ(bytes, "");
  }
}

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
