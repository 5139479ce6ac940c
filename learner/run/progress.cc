#include "learner/run/progress.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>

#include "common/base/crafter.h"
#include "common/base/numbers.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kFirstLine = absl::Seconds(2);
constexpr absl::Duration kPlainInterval = absl::Seconds(10);
constexpr absl::Duration kTerminalInterval = absl::Milliseconds(500);
constexpr int kAllColumns = std::numeric_limits<int>::max();

}  // namespace

std::string FormatTimeLeft(double seconds) {
  const int64_t s = std::llround(seconds);
  if (s >= 86400) return absl::StrCat(s / 86400, "d", s % 86400 / 3600, "h");
  if (s >= 3600) return absl::StrCat(s / 3600, "h", s % 3600 / 60, "m");
  if (s >= 60) return absl::StrCat(s / 60, "m", s % 60, "s");
  return absl::StrCat(s, "s");
}

bool ProgressPrinter::IsLogged() { return CurrentLogFormat() == LogFormat::kJson; }

ProgressPrinter::ProgressPrinter(const Options& options, std::ostream* out, Clock* clock)
    : options_(options), out_(out), clock_(clock), start_(clock->Now()), next_(start_ + kFirstLine) {
  if (!options.run_id.empty() && !IsLogged()) *out_ << "run " << options.run_id << std::endl;
}

void ProgressPrinter::Update(int64_t steps, const ScoreBoard& score) {
  const absl::Time now = clock_->Now();
  if (now < next_) return;
  next_ = now + (InPlace() ? kTerminalInterval : kPlainInterval);
  Print(steps, score);
}

void ProgressPrinter::Finish(int64_t steps, const ScoreBoard& score) {
  Print(steps, score);
  if (InPlace()) *out_ << "\n";
  out_->flush();
}

std::string ProgressPrinter::Line(int64_t steps, const ScoreBoard& score, int columns) const {
  const int64_t total = options_.total_steps;
  // The last iteration may exceed the total.
  const double done = std::min(1.0, static_cast<double>(steps) / static_cast<double>(total));
  const double seconds = absl::ToDoubleSeconds(clock_->Now() - start_);
  const double speed = seconds > 0 ? static_cast<double>(steps - options_.start_steps) / seconds : 0;
  const double left = static_cast<double>(std::max<int64_t>(0, total - steps));
  const bool scored = score.episodes() > 0;
  std::string line = absl::StrFormat("%s/%s steps %.1f%%", WithCommas(steps), WithCommas(total), 100 * done);
  for (const std::string& part :
       {speed > 0 ? absl::StrFormat(" | %.0f/s, %s left", speed, FormatTimeLeft(left / speed)) : " | -/s, - left",
        scored ? absl::StrFormat(" | reward %.1f len %.0f", score.RecentReward(), score.RecentLength())
               : " | reward - len -",
        scored ? absl::StrFormat(" | score %.2f", score.Score()) : " | score -",
        absl::StrFormat(", %d/%d unlocked", score.Unlocked(), kNumAchievements)}) {
    if (line.size() + part.size() > static_cast<size_t>(columns)) break;
    line += part;
  }
  return line.substr(0, columns);
}

void ProgressPrinter::Print(int64_t steps, const ScoreBoard& score) {
  if (IsLogged()) {
    LogInfo("%s", Line(steps, score, kAllColumns));
    return;
  }
  out_->clear();  // of errors: a full disk may have space by now
  if (InPlace()) {
    // \033[K clears the rest of a longer line. Terminals wrap one that fills the last column.
    *out_ << "\r" << Line(steps, score, std::max(0, options_.columns() - 1)) << "\033[K";
  } else {
    *out_ << Line(steps, score, kAllColumns) << "\n";
  }
  out_->flush();
}

}  // namespace craftfleet
