// Rate-limited log lines, so that an unknown client cannot fill the disk with them.

#pragma once

#include <cstdint>
#include <map>
#include <string>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/telemetry/log.h"

namespace craftfleet {

// The first `lines` lines with a key are written at once, later ones in the next ten seconds only counted: the first
// line after these has their number. Keys must not be chosen by those who cause the lines: they could use a new one
// each time. Keeps at most 256 keys of 128 bytes, and forgets those without lines for ten seconds; all further keys
// share one entry. Thread-safe.
class LimitedLog {
 public:
  // `clock` outlives the object.
  explicit LimitedLog(Clock* clock, int lines = 1) : clock_(clock), lines_(lines) {}

  // Logs `text` as a warning or information, or only counts it.
  void Warn(absl::string_view key, absl::string_view text) ABSL_LOCKS_EXCLUDED(mu_) {
    Write(LogLevel::kWarning, key, text);
  }
  void Info(absl::string_view key, absl::string_view text) ABSL_LOCKS_EXCLUDED(mu_) {
    Write(LogLevel::kInfo, key, text);
  }

 private:
  struct Entry {
    absl::Time begun = absl::InfinitePast();  // the ten seconds
    int written = 0;                          // lines in them
    int64_t left_out = 0;
  };

  void Write(LogLevel level, absl::string_view key, absl::string_view text) ABSL_LOCKS_EXCLUDED(mu_);

  // Forgets keys whose ten seconds are over.
  void Forget(absl::Time now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  Clock* const clock_;
  const int lines_;
  Mutex mu_;
  std::map<std::string, Entry> entries_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet
