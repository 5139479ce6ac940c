// Rate-limited log lines, so that an unknown client cannot fill the disk with them.

#ifndef CRAFTFLEET_COMMON_TELEMETRY_LIMITED_LOG_H_
#define CRAFTFLEET_COMMON_TELEMETRY_LIMITED_LOG_H_

#include <cstdint>
#include <map>
#include <string>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/telemetry/log.h"

namespace craftfleet {

// The first line with a key is written at once, later ones at most every ten seconds, with the number of lines left out
// in between. Keeps at most 256 keys of 128 bytes; all further keys share one entry. Thread-safe.
class LimitedLog {
 public:
  // `clock` outlives the object.
  explicit LimitedLog(Clock* clock) : clock_(clock) {}

  // Logs `text` as a warning or information, or only counts it.
  void Warn(absl::string_view key, absl::string_view text) ABSL_LOCKS_EXCLUDED(mu_) {
    Write(LogLevel::kWarning, key, text);
  }
  void Info(absl::string_view key, absl::string_view text) ABSL_LOCKS_EXCLUDED(mu_) {
    Write(LogLevel::kInfo, key, text);
  }

 private:
  struct Entry {
    absl::Time written = absl::InfinitePast();
    int64_t left_out = 0;
  };

  void Write(LogLevel level, absl::string_view key, absl::string_view text) ABSL_LOCKS_EXCLUDED(mu_);

  Clock* const clock_;
  Mutex mu_;
  std::map<std::string, Entry> entries_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_TELEMETRY_LIMITED_LOG_H_
