// Says what an error is about.

#pragma once

#include <utility>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// `status` with "<what>: " before the message of an error. `what` is a flag, a file or a peer.
inline absl::Status WithPrefix(absl::string_view what, const absl::Status& status) {
  return status.ok() ? status : absl::Status(status.code(), absl::StrCat(what, ": ", status.message()));
}

template <typename T>
absl::StatusOr<T> WithPrefix(absl::string_view what, absl::StatusOr<T> result) {
  if (!result.ok()) return WithPrefix(what, result.status());
  return result;
}

}  // namespace craftfleet
