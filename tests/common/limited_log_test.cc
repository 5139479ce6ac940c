#include "common/limited_log.h"

#include <string>

#include <absl/strings/str_cat.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/fake_clock.h"

namespace craftfleet {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

class LimitedLogTest : public testing::Test {
 protected:
  std::string Warn(const std::string& key, const std::string& text) {
    testing::internal::CaptureStderr();
    log_.Warn(key, text);
    return testing::internal::GetCapturedStderr();
  }

  FakeClock clock_;
  LimitedLog log_{&clock_};
};

TEST_F(LimitedLogTest, CountsWhatItLeavesOut) {
  EXPECT_THAT(Warn("a", "trouble"), HasSubstr("trouble\n"));
  EXPECT_THAT(Warn("a", "trouble"), IsEmpty());
  EXPECT_THAT(Warn("a", "trouble"), IsEmpty());
  EXPECT_THAT(Warn("b", "other"), HasSubstr("other"));
  clock_.Advance(absl::Seconds(11));
  EXPECT_THAT(Warn("a", "trouble"), HasSubstr("trouble (and 2 like it in the last 11s)"));
  EXPECT_THAT(Warn("a", "trouble"), IsEmpty());
}

TEST_F(LimitedLogTest, AnyNumberOfKeysIsALimitedNumberOfLines) {
  int lines = 0;
  for (int i = 0; i < 1000; ++i) lines += Warn(absl::StrCat("key ", i), "x").empty() ? 0 : 1;
  EXPECT_LE(lines, 257);
}

}  // namespace
}  // namespace craftfleet
