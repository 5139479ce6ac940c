#include "learner/training/records/disk_wait.h"

#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

absl::string_view Remedy(const absl::Status& error) {
  if (absl::IsResourceExhausted(error)) return "free space on that disk";
  if (absl::IsPermissionDenied(error)) return "make that disk writable";
  return "check that disk and its connection: the kernel's log (dmesg) may say more";
}

}  // namespace

void DiskWait::Report(const absl::Status& error, absl::string_view consequence) {
  if (clock_->Now() - reported_ < kReportEvery) return;
  reported_ = clock_->Now();
  LogError("%s; %s; %s", error.message(), consequence, Remedy(error));
}

bool DiskWait::Wait(const absl::Status& error, absl::string_view consequence) {
  Report(error, consequence);
  return !stop_->Sleep(tick_);
}

}  // namespace craftfleet
