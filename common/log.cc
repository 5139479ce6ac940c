#include "common/log.h"

#include <cstdio>
#include <string>

#include <absl/time/clock.h>
#include <absl/time/time.h>

namespace craftfleet {
namespace {

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

}  // namespace

void Log(LogLevel level, absl::string_view text) {
  const std::string line = absl::StrFormat(
      "%s %s: %s\n", absl::FormatTime("%H:%M:%E3S", absl::Now(), absl::LocalTimeZone()), LevelName(level), text);
  std::fwrite(line.data(), 1, line.size(), stderr);
}

}  // namespace craftfleet
