// The commands that steer a run.

#pragma once

#include <cstdint>
#include <functional>
#include <utility>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "learner/scheduling/worker_registry.h"
#include "learner/training/records/checkpoint_requests.h"

namespace craftfleet {

// What the admin service and the live page have in common. Each command is logged with `caller`, such as
// "admin ipv4:127.0.0.1:4711". None waits unless it says so. Thread-safe; its parts outlive it.
class Steering {
 public:
  struct Parts {
    CheckpointRequests* checkpoints;
    WorkerRegistry* registry;
    std::function<void()> stop;  // asks the learner to stop; returns at once
  };

  explicit Steering(Parts parts) : parts_(std::move(parts)) {}

  // Waits for the checkpoint; returns its iteration.   Errors as CheckpointRequests::Ask.
  absl::StatusOr<int64_t> Checkpoint(absl::string_view caller, absl::Duration timeout);
  void Pause(absl::string_view caller);
  // Returns whether the run was paused.
  bool Resume(absl::string_view caller);
  // `worker` is a name or an address.   InvalidArgument: it is empty.   NotFound: no such worker; lists those there
  // are.
  absl::StatusOr<WorkerRegistry::WorkerId> SetDraining(absl::string_view caller, absl::string_view worker,
                                                       bool draining);
  void Stop(absl::string_view caller);

  // Whether no fragment is being played.
  bool IsStill() const { return parts_.registry->lanes()->table().playing() == 0; }
  bool IsDrained(const WorkerRegistry::WorkerId& worker) const { return parts_.registry->IsDrained(worker); }

 private:
  const Parts parts_;
};

}  // namespace craftfleet
