#include "common/telemetry/limited_log.h"

#include <absl/strings/str_cat.h>

namespace craftfleet {
namespace {

constexpr absl::Duration kPeriod = absl::Seconds(10);
constexpr size_t kMaxKeys = 256;
constexpr size_t kMaxKeyBytes = 128;

}  // namespace

void LimitedLog::Write(LogLevel level, absl::string_view key, absl::string_view text) {
  const MutexLock lock(&mu_);
  const absl::Time now = clock_->Now();
  std::string name(key.substr(0, kMaxKeyBytes));
  if (entries_.size() >= kMaxKeys && entries_.count(name) == 0) name.clear();
  Entry& entry = entries_[name];
  if (now - entry.written < kPeriod) {
    ++entry.left_out;
    return;
  }
  const std::string left_out = entry.left_out == 0 ? ""
                                                   : absl::StrFormat(" (and %d like it in the last %s)", entry.left_out,
                                                                     absl::FormatDuration(now - entry.written));
  Log(level, absl::StrCat(text, left_out));
  entry = {now, 0};
}

}  // namespace craftfleet
