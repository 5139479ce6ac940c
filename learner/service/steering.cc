#include "learner/service/steering.h"

#include <absl/status/status.h>

#include "common/base/printable.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr size_t kMaxLogged = 200;  // bytes of a client's text

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

absl::StatusOr<WorkerRegistry::WorkerId> Steering::SetDraining(absl::string_view caller, absl::string_view worker,
                                                               bool draining) {
  LogInfo("%s: %s %s", caller, draining ? "drain" : "undrain", Printable(worker.substr(0, kMaxLogged)));
  // It would match workers without an address.
  if (worker.empty()) return absl::InvalidArgumentError("worker is empty, want a name or an address");
  return parts_.registry->SetDraining(worker, draining);
}

void Steering::Stop(absl::string_view caller) {
  LogInfo("%s: stop", caller);
  parts_.stop();
}

}  // namespace craftfleet
