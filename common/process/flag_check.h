// Errors for the values of flags: "--size=7, want 64..1024".

#ifndef CRAFTFLEET_COMMON_PROCESS_FLAG_CHECK_H_
#define CRAFTFLEET_COMMON_PROCESS_FLAG_CHECK_H_

#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// InvalidArgument that names the flag (without dashes), its value and what was expected.
template <typename Value>
absl::Status InvalidFlag(absl::string_view flag, const Value& value, absl::string_view wanted) {
  return absl::InvalidArgumentError(absl::StrCat("--", flag, "=", value, ", want ", wanted));
}

// Whether a number is within low..high; NaN is not.   InvalidArgument: it is not, as InvalidFlag.
template <typename Value>
absl::Status CheckFlagRange(absl::string_view flag, Value value, Value low, Value high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return InvalidFlag(flag, value, absl::StrCat(low, "..", high));
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROCESS_FLAG_CHECK_H_
