#include "common/process/flag_values.h"

#include <limits>
#include <optional>
#include <string>
#include <utility>

#include <absl/status/status.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/time/time.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/fakes/status_matchers.h"

namespace craftfleet {
namespace {

std::optional<int64_t> ParseCount(absl::string_view text) {
  Count count;
  std::string error;
  const bool parsed = AbslParseFlag(text, &count, &error);
  EXPECT_EQ(parsed, error.empty()) << text;
  return parsed ? std::optional<int64_t>(count.value) : std::nullopt;
}

TEST(Count, AcceptsEveryNotationOfWholeNumbers) {
  EXPECT_EQ(ParseCount("1000000"), 1'000'000);
  EXPECT_EQ(ParseCount("1e6"), 1'000'000);
  EXPECT_EQ(ParseCount("1E+6"), 1'000'000);
  EXPECT_EQ(ParseCount("1.5e6"), 1'500'000);
  EXPECT_EQ(ParseCount("1M"), 1'000'000);
  EXPECT_EQ(ParseCount("0.25M"), 250'000);
  EXPECT_EQ(ParseCount("100k"), 100'000);
  EXPECT_EQ(ParseCount("2K"), 2'000);
  EXPECT_EQ(ParseCount("3G"), 3'000'000'000);
  EXPECT_EQ(ParseCount("2.50e1"), 25);
  EXPECT_EQ(ParseCount("7.0"), 7);
  EXPECT_EQ(ParseCount("0"), 0);
  EXPECT_EQ(ParseCount("-3"), -3) << "ranges are checked elsewhere";
  EXPECT_EQ(ParseCount("9223372036854775807"), std::numeric_limits<int64_t>::max());
  EXPECT_EQ(ParseCount("9007199254740993"), 9'007'199'254'740'993) << "no double in between";
  EXPECT_EQ(ParseCount("9007199254740.993k"), 9'007'199'254'740'993);
}

TEST(Count, RefusesOtherText) {
  for (const char* text : {"1.5",
                           "1e-3",
                           "1.2345e3",
                           "0.0001k",
                           "1e",
                           "e6",
                           ".5M",
                           "1.",
                           "1..5M",
                           "1.-5M",
                           "1. 5M",
                           "k",
                           "M",
                           "",
                           "abc",
                           "1x",
                           "1Mk",
                           "1e6e6",
                           "1,000",
                           "0x10",
                           "inf",
                           "9223372036854775808",
                           "10e18",
                           "1e19",
                           "1e99999999999"}) {
    EXPECT_EQ(ParseCount(text), std::nullopt) << text;
  }
}

TEST(Count, ErrorsNameTheNotations) {
  Count count;
  std::string error;
  EXPECT_FALSE(AbslParseFlag("abc", &count, &error));
  EXPECT_EQ(error, "a whole number, such as 1000000, 1e6, 100k or 1M");
}

TEST(Count, UnparsesWithoutSuffix) { EXPECT_EQ(AbslUnparseFlag(Count{1'000'000}), "1000000"); }

TEST(TimeSpan, NumbersWithoutUnitAreSeconds) {
  TimeSpan span;
  std::string error;
  const auto parsed = [&](absl::string_view text) {
    EXPECT_TRUE(AbslParseFlag(text, &span, &error)) << text << ": " << error;
    return span.value;
  };
  EXPECT_EQ(parsed("5"), absl::Seconds(5));
  EXPECT_EQ(parsed("0.5"), absl::Milliseconds(500));
  EXPECT_EQ(parsed("0"), absl::ZeroDuration());
  EXPECT_EQ(parsed("-1"), absl::Seconds(-1));
  EXPECT_EQ(parsed("250ms"), absl::Milliseconds(250));
  EXPECT_EQ(parsed("1m30s"), absl::Seconds(90));
  EXPECT_EQ(parsed("24h"), absl::Hours(24));
  EXPECT_EQ(AbslUnparseFlag(span), "24h");
}

TEST(TimeSpan, ARangeIsWrittenWithUnits) {
  const auto checked = [](absl::Duration value) {
    return CheckFlagRange("wait", value, absl::Milliseconds(100), absl::Hours(1));
  };
  EXPECT_THAT(checked(absl::Milliseconds(100)), IsOk());
  EXPECT_THAT(checked(absl::Hours(1)), IsOk());
  for (const auto& [value, text] : {std::pair(absl::Milliseconds(99), "99ms"), std::pair(absl::Minutes(61), "1h1m")}) {
    EXPECT_THAT(checked(value),
                StatusIs(absl::StatusCode::kInvalidArgument, absl::StrCat("--wait=", text, ", want 100ms..1h")));
  }
}

TEST(CheckFlagRange, NamesTheExactNumber) {
  EXPECT_THAT(CheckFlagRange("speed", 256.0, 0.25, 256.0), IsOk());
  EXPECT_THAT(CheckFlagRange("speed", 256.0000001, 0.25, 256.0),
              StatusIs(absl::StatusCode::kInvalidArgument, "--speed=256.0000001, want 0.25..256"));
}

TEST(TimeSpan, ErrorsNameTheUnits) {
  TimeSpan span;
  for (const char* text : {"", "soon", "5 s", "5seconds", "1d"}) {
    std::string error;
    EXPECT_FALSE(AbslParseFlag(text, &span, &error)) << text;
    EXPECT_TRUE(absl::StrContains(error, "a number without a unit is in seconds")) << error;
  }
}

}  // namespace
}  // namespace craftfleet
