#include "learner/disk_wait.h"

#include "common/telemetry/log.h"

namespace craftfleet {

void DiskWait::Report(absl::string_view error) {
  if (clock_->Now() - reported_ < kReportEvery) return;
  reported_ = clock_->Now();
  LogError("%s; free space on that disk", error);
}

bool DiskWait::Wait(absl::string_view error) {
  Report(error);
  return !stop_->Sleep(tick_);
}

}  // namespace craftfleet
