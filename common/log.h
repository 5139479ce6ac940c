// One line per event on standard error: time, level, text.

#ifndef CRAFTFLEET_COMMON_LOG_H_
#define CRAFTFLEET_COMMON_LOG_H_

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
  LogLevel level = LogLevel::kInfo;  // lower ones are not written
  LogFormat format = LogFormat::kText;
  std::string program;  // named in JSON
};

// How this process logs from now on. Call it before other threads begin; ParseFlags does.
void SetUpLog(const LogOptions& options);

// How lines look since SetUpLog.
LogFormat CurrentLogFormat();

// Writes the line in one piece. Thread-safe.
void Log(LogLevel level, absl::string_view text);

inline constexpr size_t kMaxLogLineBytes = 1024;  // of a line, with its end

// `text`, or as much of its beginning as leaves room within `max_bytes`, 32 at least, to say how long it was:
// "abc... (5000 bytes)". A character of several bytes is not cut.
std::string Shortened(absl::string_view text, size_t max_bytes);

// The line of an event, with its end. `text` may come from a stranger: control characters are escaped, and what makes a
// line longer than kMaxLogLineBytes is left out.
std::string FormatLogLine(const LogOptions& options, LogLevel level, absl::string_view text, absl::Time time);

// What was logged since the start, written or not.
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

// Something to know about; the program goes on, and tries again where that may help.
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

#endif  // CRAFTFLEET_COMMON_LOG_H_
