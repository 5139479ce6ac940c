// Collects the fragments of one iteration.

#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/base/clock.h"
#include "common/base/closable_queue.h"
#include "common/base/types.h"
#include "learner/scheduling/worker_registry.h"

namespace craftfleet {

// The accepted fragments on their way from the streams that receive them; bounded by the number of permits.
using FragmentQueue = ClosableQueue<Fragment>;

// Waits for the fragments of an iteration, whose permits are open, and drops those of lanes that were reset in the
// meantime. Owned by the training thread.
class FragmentCollector {
 public:
  struct Parts {
    WorkerRegistry* registry;  // all pointers outlive the collector
    FragmentQueue* fragments;
    Clock* clock;
  };
  // Called after each fragment and at least every 0.2 s. `collected`: fragments collected so far; `is_idle`: nothing
  // arrived since the last call. An error ends the wait.
  using OnTick = std::function<absl::Status(size_t collected, bool is_idle)>;

  explicit FragmentCollector(const Parts& parts) : parts_(parts) {}

  // Waits until `wanted` fragments are collected; returns them ordered by lane and number. Errors are those of
  // `on_tick`.
  absl::StatusOr<std::vector<Fragment>> Collect(size_t wanted, const OnTick& on_tick);
  // With max_staleness: waits for the `wanted` fragments of the next update (RolloutCutter::TakeRollout); returns them
  // ordered by lane and number. Fragments for later updates are kept. Errors as Collect.
  absl::StatusOr<std::vector<Fragment>> CollectRollout(size_t wanted, const OnTick& on_tick);

 private:
  using Key = std::pair<int, int64_t>;  // lane, number

  // Waits until `is_complete` says so; it is asked after each fragment.
  absl::Status CollectUntil(const std::function<bool()>& is_complete, size_t wanted, const OnTick& on_tick);
  // Adds a fragment unless its lane was reset since; it replaces one of the same lane and number.
  void Add(Fragment fragment);
  // Drops the fragments of lanes that were reset.
  void DropReset();

  const Parts parts_;
  std::map<Key, Fragment> collected_;
};

}  // namespace craftfleet
