// The progress line that is printed while a run trains.

#pragma once

#include <cstdint>
#include <functional>
#include <ostream>
#include <string>

#include <absl/time/time.h>

#include "common/base/clock.h"
#include "learner/run/score.h"

namespace craftfleet {

// Formats a duration in seconds: "3d4h", "2h5m", "13m20s", "8s".
std::string FormatTimeLeft(double seconds);

// Prints "12,288/1,000,000 steps 1.2% | 1234/s, 13m20s left | reward 2.3 len 187 | score 3.12, 9/22 unlocked": on a
// terminal, one line in place, without the last parts if they do not fit; otherwise a line every 10 s, the first after
// 2 s. With --log_format=json, progress is logged instead. Thread-compatible: one thread at a time.
class ProgressPrinter {
 public:
  struct Options {
    std::function<int()> columns;  // the present width of the terminal `out`; null: it is not a terminal
    int64_t start_steps = 0;       // environment steps done before this start
    int64_t total_steps = 1;
    std::string run_id;  // printed at the start unless empty
  };
  // `out` and `clock` outlive the printer. Speed is measured from construction on.
  ProgressPrinter(const Options& options, std::ostream* out, Clock* clock);

  // Prints if a line is due. To be called often.
  void Update(int64_t steps, const ScoreBoard& score);

  // Prints the last line, even if none is due, and ends it.
  void Finish(int64_t steps, const ScoreBoard& score);

 private:
  static bool IsLogged();
  bool InPlace() const { return options_.columns != nullptr && !IsLogged(); }
  // The parts of the line that fit into `columns`.
  std::string Line(int64_t steps, const ScoreBoard& score, int columns) const;
  void Print(int64_t steps, const ScoreBoard& score);

  const Options options_;
  std::ostream* const out_;
  Clock* const clock_;
  const absl::Time start_;
  absl::Time next_;
};

}  // namespace craftfleet
