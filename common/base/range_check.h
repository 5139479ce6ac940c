// Checks of a configuration's values, with messages that name the field.

#pragma once

#include <cstdint>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

#include "common/base/numbers.h"

namespace craftfleet {

// Of anything that is counted: doubles, which metrics are, count exactly up to here.
inline constexpr int64_t kMaxCount = int64_t{1} << 52;

// Keeps the error of the first check that fails.
class RangeCheck {
 public:
  // NaN is never within a range.
  template <typename T>
  void Within(absl::string_view field, T value, T low, T high) {
    if (!(value >= low && value <= high))
      Fail(absl::StrCat(field, " is ", Exactly(value), ", want ", Exactly(low), "..", Exactly(high)));
  }
  void Positive(absl::string_view field, double value, double high) {
    if (value > 0 && value <= high) return;
    Fail(absl::StrCat(field, " is ", ExactNumber(value), ", want more than 0, at most ", ExactNumber(high)));
  }
  void Named(absl::string_view field, absl::string_view value) {
    if (value.empty()) Fail(absl::StrCat(field, " is empty, want a name"));
  }
  void Multiple(absl::string_view field, int64_t value, absl::string_view of, int64_t divisor) {
    if (value % divisor != 0) Fail(absl::StrCat(field, " is ", value, ", want a multiple of ", of, " (", divisor, ")"));
  }
  // For other conditions; `message` is the whole error.
  void That(bool condition, absl::string_view message) {
    if (!condition) Fail(std::string(message));
  }
  const absl::Status& status() const { return status_; }  // InvalidArgument, or OK

 private:
  void Fail(const std::string& message) {
    if (status_.ok()) status_ = absl::InvalidArgumentError(message);
  }
  absl::Status status_;
};

}  // namespace craftfleet
