// Values of flags: convenient notations (1e6 for a number of steps, 5 for five seconds), and errors for those out of
// range: "--size=7, want 64..1024".

#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/numbers.h"

namespace craftfleet {

// A whole number: 1000000, 1e6, 1.5e6, 100k, 1M or 2G (thousands, millions, billions). Fractions and values beyond 64
// bits are refused.
struct Count {
  static constexpr char kWanted[] = "a whole number, such as 1000000, 1e6, 100k or 1M";
  int64_t value = 0;
};
bool AbslParseFlag(absl::string_view text, Count* count, std::string* error);
std::string AbslUnparseFlag(const Count& count);

// A duration: 500ms, 5s, 1m30s, 2h, or a plain number of seconds, such as 5 or 0.5.
struct TimeSpan {
  static constexpr char kWanted[] =
      "a length of time, such as 500ms, 5s, 1m30s or 2h; a number without a unit is in seconds";
  absl::Duration value;
};
bool AbslParseFlag(absl::string_view text, TimeSpan* span, std::string* error);
std::string AbslUnparseFlag(const TimeSpan& span);

// An address that may be given as empty, which differs from not given: Abseil parses "" as an absent optional.
struct GivenAddress {
  std::optional<std::string> address;
};
bool AbslParseFlag(absl::string_view text, GivenAddress* given, std::string* error);
std::string AbslUnparseFlag(const GivenAddress& given);

// InvalidArgument that names the flag (without dashes), its value and what was expected.
template <typename Value>
absl::Status InvalidFlag(absl::string_view flag, const Value& value, absl::string_view wanted) {
  return absl::InvalidArgumentError(absl::StrCat("--", flag, "=", Exactly(value), ", want ", wanted));
}

// Whether a number or duration is within low..high; NaN is not.   InvalidArgument: it is not, as InvalidFlag.
template <typename Value>
absl::Status CheckFlagRange(absl::string_view flag, Value value, Value low, Value high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return InvalidFlag(flag, value, absl::StrCat(Exactly(low), "..", Exactly(high)));
}
absl::Status CheckFlagRange(absl::string_view flag, absl::Duration value, absl::Duration low, absl::Duration high);

}  // namespace craftfleet
