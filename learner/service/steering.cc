#include "learner/service/steering.h"

#include <absl/status/status.h>

#include "common/base/printable.h"
#include "common/base/status_macros.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr size_t kMaxLogged = 200;  // bytes of a client's text

// Logs the command. An empty name would match workers without an address.
absl::Status Begin(absl::string_view caller, absl::string_view command, absl::string_view worker) {
  LogInfo("%s: %s %s", caller, command, Printable(worker.substr(0, kMaxLogged)));
  return worker.empty() ? absl::InvalidArgumentError("worker is empty, want a name or an address") : absl::OkStatus();
}

}  // namespace

absl::StatusOr<int64_t> Steering::Checkpoint(absl::string_view caller, absl::Duration timeout) {
  LogInfo("%s: checkpoint", caller);
  return parts_.checkpoints->Ask(timeout);
}

void Steering::Pause(absl::string_view caller) {
  LogInfo("%s: pause", caller);
  parts_.registry->lanes()->assignment().SetPaused(true);
}

bool Steering::Resume(absl::string_view caller) {
  LogInfo("%s: resume", caller);
  return parts_.registry->lanes()->assignment().SetPaused(false);
}

absl::StatusOr<WorkerRegistry::WorkerId> Steering::Drain(absl::string_view caller, absl::string_view worker) {
  CRAFTFLEET_RETURN_IF_ERROR(Begin(caller, "drain", worker));
  return parts_.registry->Drain(worker);
}

absl::StatusOr<WorkerRegistry::WorkerId> Steering::Undrain(absl::string_view caller, absl::string_view worker) {
  CRAFTFLEET_RETURN_IF_ERROR(Begin(caller, "undrain", worker));
  return parts_.registry->Undrain(worker);
}

void Steering::Stop(absl::string_view caller) {
  LogInfo("%s: stop", caller);
  parts_.stop();
}

}  // namespace craftfleet
