#include "common/telemetry/log.h"

#include <algorithm>
#include <atomic>
#include <cstdio>

#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>
#include <nlohmann/json.hpp>

#include "common/base/mutex.h"

namespace craftfleet {
namespace {

constexpr size_t kLeastText = 64;  // bytes of text that a line has room for in any case

// One log per process, because it has one standard error.
struct ProcessLog {
  LogOptions options;  // constant once there are threads
  std::atomic<int64_t> warnings{0};
  std::atomic<int64_t> errors{0};
  Mutex mu;
  std::string last_error ABSL_GUARDED_BY(mu);
};

ProcessLog& TheLog() {
  static ProcessLog* const log = new ProcessLog;  // never deleted: threads may log until the process ends
  return *log;
}

const char* LevelName(LogLevel level) {
  switch (level) {
    case LogLevel::kInfo:
      return "info";
    case LogLevel::kWarning:
      return "warning";
    case LogLevel::kError:
      return "error";
  }
  return "?";
}

std::string EscapeControls(absl::string_view text) {
  std::string line;
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    // In UTF-8, those from U+0080 to U+009F are two bytes, and terminals obey them too.
    const bool is_high = c == '\xc2' && i + 1 < text.size() && (static_cast<unsigned char>(text[i + 1]) & 0xe0) == 0x80;
    if (c == '\n') {
      line += "\\n";
    } else if (is_high) {
      absl::StrAppendFormat(&line, "\\u%04x", static_cast<unsigned char>(text[++i]));
    } else if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) {
      absl::StrAppendFormat(&line, "\\x%02x", static_cast<unsigned char>(c));
    } else {
      line += c;
    }
  }
  return line;
}

// The line with all of `text`.
std::string WholeLine(const LogOptions& options, LogLevel level, absl::string_view text, absl::Time time) {
  if (options.format == LogFormat::kText) {
    return absl::StrFormat("%s %s: %s\n", absl::FormatTime("%H:%M:%E3S", time, absl::LocalTimeZone()), LevelName(level),
                           EscapeControls(text));
  }
  nlohmann::ordered_json line;
  line["time"] = absl::FormatTime("%Y-%m-%dT%H:%M:%E3SZ", time, absl::UTCTimeZone());
  line["level"] = LevelName(level);
  line["program"] = options.program;
  const std::string message(text);
  line["message"] = message;
  // In ASCII, so that DEL and the control characters of two bytes are escaped too.
  return line.dump(-1, ' ', /*ensure_ascii=*/true, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

}  // namespace

void SetUpLog(const LogOptions& options) { TheLog().options = options; }

LogFormat CurrentLogFormat() { return TheLog().options.format; }

std::string Shortened(absl::string_view text, size_t max_bytes) {
  if (text.size() <= max_bytes) return std::string(text);
  const std::string end = absl::StrFormat("... (%d bytes)", text.size());
  size_t kept = max_bytes > end.size() ? max_bytes - end.size() : 0;
  const auto goes_on = [&](char c) { return (static_cast<unsigned char>(c) & 0xc0) == 0x80; };
  for (int i = 0; i < 3 && kept > 0 && goes_on(text[kept]); ++i) --kept;
  return std::string(text.substr(0, kept)) + end;
}

std::string FormatLogLine(const LogOptions& options, LogLevel level, absl::string_view text, absl::Time time) {
  size_t room = kMaxLogLineBytes;
  std::string line = WholeLine(options, level, Shortened(text, room), time);
  // A byte of text takes one byte of the line, or up to six if it is escaped.
  while (line.size() > kMaxLogLineBytes && room > kLeastText) {
    room -= std::min(room - kLeastText, std::max<size_t>((line.size() - kMaxLogLineBytes) / 6, 1));
    line = WholeLine(options, level, Shortened(text, room), time);
  }
  return line;
}

void Log(LogLevel level, absl::string_view text) {
  ProcessLog& log = TheLog();
  if (level == LogLevel::kWarning) ++log.warnings;
  if (level == LogLevel::kError) {
    ++log.errors;
    const MutexLock lock(&log.mu);
    log.last_error = Shortened(text, kMaxLogLineBytes);
  }
  if (level < log.options.level) return;
  const std::string line = FormatLogLine(log.options, level, text, absl::Now());
  std::fwrite(line.data(), 1, line.size(), stderr);
}

LogCounts CountLogged() {
  ProcessLog& log = TheLog();
  const MutexLock lock(&log.mu);
  return {log.warnings.load(), log.errors.load(), log.last_error};
}

}  // namespace craftfleet
