// Which fragments make a rollout, and how far play runs ahead of the updates.

#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "common/base/clock.h"
#include "common/base/types.h"
#include "common/telemetry/limited_log.h"
#include "learner/scheduling/lane_table.h"

namespace craftfleet {

// Synchronous by default: within an iteration, each lane gets one permit after the other, all with the iteration's
// weights, and the rollout has the fragments of all lanes. With `Options::max_staleness` a lane gets its next permit as
// soon as its last fragment is in, with the newest weights. TakeRollout cuts the fragments, in the order in which they
// were accepted, into rollouts for one update after the other; it is thus known when a fragment arrives which update
// would learn from it. A fragment that would then be more than max_staleness versions old is dropped and counted, and
// its lane plays it again. Permits run ahead only as far as drops are impossible if fragments arrive in the order of
// their permits: max_staleness rollouts beyond that of the newest weights. Not thread-safe.
class RolloutCutter {
 public:
  struct Options {
    // Asynchronous play: most versions between the weights of a fragment and those from which the update with it
    // starts; 0: play is synchronous.
    int max_staleness = 0;
    int64_t rollout_fragments = 1;  // of an update; only with max_staleness
  };

  // The pointers outlive it.
  RolloutCutter(const Options& options, LaneTable* table, Clock* clock)
      : options_(options), table_(table), clock_(clock), drops_(clock) {}

  bool is_asynchronous() const { return options_.max_staleness > 0; }

  // Opens the next iteration: permits for fragments up to `last_fragment` (excluded) of each lane, with
  // `policy_version`. With max_staleness an iteration begins at TakeRollout instead.
  void OpenIteration(int64_t last_fragment, int64_t policy_version);
  // With max_staleness: new permits have `policy_version`, from which the update with the next rollout will start.
  void PublishVersion(int64_t policy_version);
  // With max_staleness: the fragments that the next update learns from, in the order of their arrival, once they are
  // complete; from then on no reset affects them. The update after that starts from the next version.
  std::optional<std::vector<Arrival>> TakeRollout();
  // Rolls every lane back to the beginning of the iteration, or of the one before if `iterations` is 2; nothing is
  // granted until the next Open... or PublishVersion. Must not be called again before it.
  void RewindIterations(int iterations);
  // Rolls the lane back to the beginning of the iteration.
  void RewindLane(LaneState* lane);

  // Of new permits.
  int64_t policy_version() const { return policy_version_; }
  // How many more permits may be granted.
  int64_t Ahead() const;
  // Puts a fragment of `sender` that has arrived into the rollout that is due; `snapshot` is after it. Returns whether
  // it may be learned from; if not, it is counted and logged.
  bool Take(const Permit& fragment, uint64_t digest, const SharedSnapshot& snapshot, const LaneActor& sender);

 private:
  // A fragment accepted for a rollout that is not taken yet.
  struct WaitingArrival {
    Arrival arrival;
    SharedSnapshot snapshot;  // after it
    std::string sender;
  };

  // With max_staleness: how old a fragment that arrives now will be when it is learned from.
  int64_t StalenessOf(int64_t policy_version) const;
  // The lanes that nobody plays count as free from now on.
  void BeginPermits();

  const Options options_;
  LaneTable* const table_;
  Clock* const clock_;
  int64_t policy_version_ = 0;
  std::deque<WaitingArrival> waiting_;  // in the order of arrival
  int64_t next_update_ = 0;             // version from which the update with the next rollout will start
  LimitedLog drops_;
};

}  // namespace craftfleet
