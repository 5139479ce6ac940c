// Waits for free space while the disk of the run folder is full.

#ifndef CRAFTFLEET_LEARNER_DISK_WAIT_H_
#define CRAFTFLEET_LEARNER_DISK_WAIT_H_

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "learner/stop_flag.h"

namespace craftfleet {

// Logs the error, at a limited rate, and waits for free space. Owned by one thread.
class DiskWait {
 public:
  static constexpr absl::Duration kReportEvery = absl::Seconds(15);

  // `stop` and `clock` outlive this. `tick`: time between two attempts to write.
  DiskWait(const StopFlag* stop, Clock* clock, absl::Duration tick = absl::Seconds(1))
      : stop_(stop), clock_(clock), tick_(tick) {}

  // Logs `error` and the remedy, at most once in kReportEvery.
  void Report(absl::string_view error);
  // Reports `error`, then waits one `tick`. Returns false if training is asked to stop.
  bool Wait(absl::string_view error);

 private:
  const StopFlag* const stop_;
  Clock* const clock_;
  const absl::Duration tick_;
  absl::Time reported_ = absl::InfinitePast();
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_DISK_WAIT_H_
