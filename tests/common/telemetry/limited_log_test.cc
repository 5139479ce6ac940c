#include "common/telemetry/limited_log.h"

#include <algorithm>
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

TEST_F(LimitedLogTest, ReportsHowManyLinesItLeftOut) {
  EXPECT_THAT(Warn("a", "problem"), HasSubstr("problem\n"));
  EXPECT_THAT(Warn("a", "problem"), IsEmpty());
  EXPECT_THAT(Warn("a", "problem"), IsEmpty());
  EXPECT_THAT(Warn("b", "other"), HasSubstr("other"));
  clock_.Advance(absl::Seconds(11));
  EXPECT_THAT(Warn("a", "problem"), HasSubstr("problem (and 2 like it in the last 11s)"));
  EXPECT_THAT(Warn("a", "problem"), IsEmpty());
}

TEST_F(LimitedLogTest, HasLevels) {
  EXPECT_THAT(Warn("a", "problem"), HasSubstr("warning: problem"));
  testing::internal::CaptureStderr();
  log_.Info("b", "news");
  log_.Info("b", "news");
  EXPECT_THAT(testing::internal::GetCapturedStderr(),
              testing::AllOf(HasSubstr("news"), testing::Not(HasSubstr("warning"))));
}

TEST_F(LimitedLogTest, ManyKeysProduceALimitedNumberOfLines) {
  int lines = 0;
  for (int i = 0; i < 1000; ++i) lines += Warn(absl::StrCat("key ", i), "x").empty() ? 0 : 1;
  EXPECT_LE(lines, 257);
}

TEST_F(LimitedLogTest, OldKeysAreForgotten) {
  for (int i = 0; i < 1000; ++i) Warn(absl::StrCat("key ", i), "x");
  EXPECT_THAT(Warn("new", "first"), IsEmpty()) << "it shares an entry with the others";
  clock_.Advance(absl::Seconds(11));
  EXPECT_THAT(Warn("one", "first"), HasSubstr("first"));
  EXPECT_THAT(Warn("two", "first"), HasSubstr("first"));
}

TEST_F(LimitedLogTest, MayWriteSeveralLinesWithAKey) {
  LimitedLog log(&clock_, 3);
  const auto lines = [&](int count) {
    testing::internal::CaptureStderr();
    for (int i = 0; i < count; ++i) log.Warn("client", absl::StrCat("line ", i));
    const std::string text = testing::internal::GetCapturedStderr();
    return std::count(text.begin(), text.end(), '\n');
  };
  EXPECT_EQ(lines(5), 3);
  clock_.Advance(absl::Seconds(11));
  EXPECT_EQ(lines(5), 3);
}

// Keys may be names that a client made up.
TEST_F(LimitedLogTest, KeysAreCut) {
  EXPECT_THAT(Warn(std::string(1000, 'k') + "1", "first"), HasSubstr("first"));
  EXPECT_THAT(Warn(std::string(1000, 'k') + "2", "second"), IsEmpty());
}

}  // namespace
}  // namespace craftfleet
