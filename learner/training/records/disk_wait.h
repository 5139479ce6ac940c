// Waits while the disk of the run folder cannot be written.

#pragma once

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "learner/training/stop_flag.h"

namespace craftfleet {

// Logs the error, at a limited rate, and waits for the disk. Owned by one thread.
class DiskWait {
 public:
  static constexpr absl::Duration kReportEvery = absl::Seconds(15);

  // `stop` and `clock` outlive this. `tick`: time between two attempts to write.
  DiskWait(const StopFlag* stop, Clock* clock, absl::Duration tick = absl::Seconds(1))
      : stop_(stop), clock_(clock), tick_(tick) {}

  // Logs `error`, that of a write (common/io/files.h), its `consequence` and the remedy, at most once in kReportEvery.
  void Report(const absl::Status& error, absl::string_view consequence);
  // Reports, then waits one `tick`. Returns false if training is asked to stop.
  bool Wait(const absl::Status& error, absl::string_view consequence);

 private:
  const StopFlag* const stop_;
  Clock* const clock_;
  const absl::Duration tick_;
  absl::Time reported_ = absl::InfinitePast();
};

}  // namespace craftfleet
