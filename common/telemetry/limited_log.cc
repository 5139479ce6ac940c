#include "common/telemetry/limited_log.h"

#include <iterator>

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
  if (entries_.size() >= kMaxKeys && entries_.count(name) == 0) Forget(now);
  if (entries_.size() >= kMaxKeys && entries_.count(name) == 0) name.clear();
  Entry& entry = entries_[name];
  if (now - entry.begun < kPeriod && entry.written >= lines_) {
    ++entry.left_out;
    return;
  }
  const std::string left_out = entry.left_out == 0 ? ""
                                                   : absl::StrFormat(" (and %d like it in the last %s)", entry.left_out,
                                                                     absl::FormatDuration(now - entry.begun));
  if (now - entry.begun >= kPeriod) entry = {now, 0, 0};
  ++entry.written;
  Log(level, absl::StrCat(text, left_out));
}

void LimitedLog::Forget(absl::Time now) {
  for (auto entry = entries_.begin(); entry != entries_.end();) {
    entry = now - entry->second.begun < kPeriod ? std::next(entry) : entries_.erase(entry);
  }
}

}  // namespace craftfleet
