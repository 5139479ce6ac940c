// One line per event on standard error: time, level, text.

#ifndef CRAFTFLEET_COMMON_LOG_H_
#define CRAFTFLEET_COMMON_LOG_H_

#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

enum class LogLevel { kInfo, kWarning, kError };

// Writes the line in one piece. Thread-safe.
void Log(LogLevel level, absl::string_view text);

template <typename... Args>
void LogInfo(const absl::FormatSpec<Args...>& format, const Args&... args) {
  Log(LogLevel::kInfo, absl::StrFormat(format, args...));
}

// Something to know about; the program goes on.
template <typename... Args>
void LogWarning(const absl::FormatSpec<Args...>& format, const Args&... args) {
  Log(LogLevel::kWarning, absl::StrFormat(format, args...));
}

// Something that a person must act on.
template <typename... Args>
void LogError(const absl::FormatSpec<Args...>& format, const Args&... args) {
  Log(LogLevel::kError, absl::StrFormat(format, args...));
}

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_LOG_H_
