// Matchers for absl::Status and absl::StatusOr, which the packaged Abseil lacks.

#pragma once

#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <gmock/gmock.h>

namespace craftfleet {

inline const absl::Status& ToStatus(const absl::Status& status) { return status; }

template <typename T>
const absl::Status& ToStatus(const absl::StatusOr<T>& value) {
  return value.status();
}

// EXPECT_THAT(Load(path), IsOk());
MATCHER(IsOk, "is ok") {
  *result_listener << ToStatus(arg).ToString();
  return ToStatus(arg).ok();
}

// EXPECT_THAT(Load(path), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("is torn")));
MATCHER_P2(StatusIs, code, message, "has that code and a matching message") {
  *result_listener << ToStatus(arg).ToString();
  const std::string text(ToStatus(arg).message());
  return ToStatus(arg).code() == code && testing::ExplainMatchResult(message, text, result_listener);
}

}  // namespace craftfleet
