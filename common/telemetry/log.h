// One line per event on standard error: time, level, text.

#pragma once

#include <cstdint>
#include <string>

#include <absl/strings/str_format.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

namespace craftfleet {

enum class LogLevel { kInfo, kWarning, kError };
enum class LogFormat {
  kText,  // 17:32:08.123 warning: text
  kJson,  // {"time":"2026-03-01T16:32:08.123Z","level":"warning","program":"craftfleet-actor","message":"text"}
};

struct LogOptions {
  LogLevel level = LogLevel::kInfo;  // lines of lower levels are not written
  LogFormat format = LogFormat::kText;
  std::string program;  // named in JSON
};

// Sets the options of this process's log. Call it before other threads start; ParseFlags does.
void SetUpLog(const LogOptions& options);

// The format set by SetUpLog.
LogFormat CurrentLogFormat();

// Writes the line in one piece. Thread-safe.
void Log(LogLevel level, absl::string_view text);

inline constexpr size_t kMaxLogLineBytes = 1024;  // of a line, with its end

// `text` if it fits into `max_bytes` (at least 32), else its beginning with its original length, "abc... (5000 bytes)".
// Does not cut inside a multi-byte character.
std::string Shortened(absl::string_view text, size_t max_bytes);

// The line of an event, with its newline. `text` may come from an unknown client: control characters are escaped, and
// lines are cut at kMaxLogLineBytes.
std::string FormatLogLine(const LogOptions& options, LogLevel level, absl::string_view text, absl::Time time);

// Counts of the lines logged since the start, whether written or not.
struct LogCounts {
  int64_t warnings = 0;
  int64_t errors = 0;
  std::string last_error;  // text of the last error; empty: none
};
LogCounts CountLogged();

template <typename... Args>
void LogInfo(const absl::FormatSpec<Args...>& format, const Args&... args) {
  Log(LogLevel::kInfo, absl::StrFormat(format, args...));
}

// A problem that the program recovers from; it continues, and retries where that may help.
template <typename... Args>
void LogWarning(const absl::FormatSpec<Args...>& format, const Args&... args) {
  Log(LogLevel::kWarning, absl::StrFormat(format, args...));
}

// Something that a person must act on; the text says how.
template <typename... Args>
void LogError(const absl::FormatSpec<Args...>& format, const Args&... args) {
  Log(LogLevel::kError, absl::StrFormat(format, args...));
}

}  // namespace craftfleet
