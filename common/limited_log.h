// Log lines about what strangers do: as many as they like to cause must not fill the disk.

#ifndef CRAFTFLEET_COMMON_LIMITED_LOG_H_
#define CRAFTFLEET_COMMON_LIMITED_LOG_H_

#include <cstdint>
#include <map>
#include <string>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/clock.h"
#include "common/mutex.h"

namespace craftfleet {

// Of the lines with one key the first is written at once, others at most every ten seconds, with the number of those
// left out in between. Remembers at most 256 keys; beyond these, all others count as one. Thread-safe.
class LimitedLog {
 public:
  // `clock` outlives the object.
  explicit LimitedLog(Clock* clock) : clock_(clock) {}

  // Writes `text` as a warning, or only counts it.
  void Warn(absl::string_view key, absl::string_view text) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Entry {
    absl::Time written = absl::InfinitePast();
    int64_t left_out = 0;
  };

  Clock* const clock_;
  Mutex mu_;
  std::map<std::string, Entry> entries_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_LIMITED_LOG_H_
