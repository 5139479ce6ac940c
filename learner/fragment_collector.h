// Collects the fragments of one iteration.

#ifndef CRAFTFLEET_LEARNER_FRAGMENT_COLLECTOR_H_
#define CRAFTFLEET_LEARNER_FRAGMENT_COLLECTOR_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "common/base/clock.h"
#include "common/base/types.h"
#include "learner/fragment_journal.h"
#include "learner/learner_service.h"
#include "learner/worker_registry.h"

namespace craftfleet {

// Waits for the fragments of each lane, drops those of lanes that were reset in the meantime, and records the others in
// the journal. Owned by the training thread.
class FragmentCollector {
 public:
  struct Parts {
    WorkerRegistry* registry;  // all pointers outlive the collector
    FragmentQueue* fragments;
    FragmentJournal* journal;  // null: no journal
    Clock* clock;
  };
  // Called after each fragment and at least every 0.2 s. `collected`: fragments collected so far; `is_idle`: nothing
  // arrived since the last call. An error ends the wait.
  using OnTick = std::function<absl::Status(size_t collected, bool is_idle)>;

  // `kept`: fragments that an earlier start left in the journal.
  FragmentCollector(std::vector<Fragment> kept, const Parts& parts) : parts_(parts), kept_(std::move(kept)) {}

  // Begins `iteration`: opens permits for fragments up to `last_fragment` (excluded) of each lane with the weights
  // `policy_version`. Kept fragments of this iteration count as collected.
  void Begin(int64_t iteration, int64_t last_fragment, int64_t policy_version);
  // The same for an iteration whose permits are open already, which is not the first.
  void BeginOpened();
  // Waits until `wanted` fragments are collected; returns them ordered by lane and number. Errors are those of
  // `on_tick`.
  absl::StatusOr<std::vector<Fragment>> Collect(size_t wanted, const OnTick& on_tick);
  // Empties the journal.
  void ClearJournal();

 private:
  void TakeKept(int64_t iteration, int64_t last_fragment, int64_t policy_version);
  // Adds a fragment unless its lane was reset since; it replaces a fragment of the same lane and number.
  void Add(Fragment fragment);
  // Drops the fragments of lanes that were reset, here and in the journal.
  void DropReset();
  void WriteJournal(const Fragment& fragment);

  const Parts parts_;
  std::vector<Fragment> kept_;  // empty once the first iteration has begun
  std::vector<Fragment> collected_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_FRAGMENT_COLLECTOR_H_
