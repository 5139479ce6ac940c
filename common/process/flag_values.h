// Flag types with convenient notations: 1e6 for a number of steps, 5 for five seconds.

#ifndef CRAFTFLEET_COMMON_PROCESS_FLAG_VALUES_H_
#define CRAFTFLEET_COMMON_PROCESS_FLAG_VALUES_H_

#include <cstdint>
#include <optional>
#include <string>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

namespace craftfleet {

// A whole number: 1000000, 1e6, 1.5e6, 100k, 1M or 2G (thousands, millions, billions). Fractions and values beyond 64
// bits are refused.
struct Count {
  int64_t value = 0;
};
bool AbslParseFlag(absl::string_view text, Count* count, std::string* error);
std::string AbslUnparseFlag(const Count& count);

// A duration: 500ms, 5s, 1m30s, 2h, or a plain number of seconds, such as 5 or 0.5.
struct TimeSpan {
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

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_FLAG_VALUES_H_
