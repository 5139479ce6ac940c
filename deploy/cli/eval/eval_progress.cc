#include "deploy/cli/eval/eval_progress.h"

#include <absl/strings/str_format.h>

#include "learner/run/progress.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kPlainInterval = absl::Seconds(10);
constexpr absl::Duration kTerminalInterval = absl::Milliseconds(200);
constexpr char kClearLine[] = "\r\033[K";

}  // namespace

EvalProgress::EvalProgress(const Options& options, std::ostream* out, Clock* clock)
    : options_(options),
      out_(out),
      clock_(clock),
      start_(clock->Now()),
      next_(start_ + (options.terminal ? kTerminalInterval : kPlainInterval)) {}

void EvalProgress::Update(int finished) {
  const absl::Time now = clock_->Now();
  if (now < next_) return;
  next_ = now + (options_.terminal ? kTerminalInterval : kPlainInterval);
  std::string line = absl::StrFormat("%s: %d of %d episodes", options_.part, finished, options_.episodes);
  if (finished > 0) {
    const double seconds_each = absl::ToDoubleSeconds(now - start_) / finished;
    absl::StrAppendFormat(&line, ", %s left", FormatTimeLeft(seconds_each * (options_.episodes - finished)));
  }
  *out_ << (options_.terminal ? kClearLine : "") << line << (options_.terminal ? "" : "\n");
  out_->flush();
}

void EvalProgress::Finish() {
  if (!options_.terminal) return;
  *out_ << kClearLine;
  out_->flush();
}

}  // namespace craftfleet
