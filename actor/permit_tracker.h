// The permits that an actor holds, shared by the thread that requests them and the loops that play.

#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include <absl/time/time.h>

#include "common/base/mutex.h"
#include "common/base/types.h"

namespace craftfleet {

// A permit held by an actor. It is identified by the permit and the epoch.
struct HeldPermit : Permit {
  int64_t epoch = 0;         // learner epoch that granted it
  std::string failure = {};  // why its lane can't be played; empty: no failure is known

  friend bool operator==(const HeldPermit& a, const HeldPermit& b) { return a.Key() == b.Key(); }
  friend bool operator!=(const HeldPermit& a, const HeldPermit& b) { return a.Key() != b.Key(); }
  friend bool operator<(const HeldPermit& a, const HeldPermit& b) { return a.Key() < b.Key(); }

 private:
  std::tuple<int64_t, int, int64_t, int64_t> Key() const { return {epoch, lane, fragment, policy_version}; }
};

// All permits of a lane go to the same loop, as do all lanes of a tile. Thread-safe.
class PermitTracker {
 public:
  explicit PermitTracker(int loops) : loops_(loops), waiting_(loops) {}

  // Distributes lanes over the first `loops` loops alone, 1 or more, by tiles of `tile` lanes, the rows of an inference
  // call; before the first permit.
  void Distribute(int tile, int loops) ABSL_LOCKS_EXCLUDED(mu_);

  // Adds a permit; ignored if it is already held.
  void Add(const HeldPermit& permit) ABSL_LOCKS_EXCLUDED(mu_);
  // Returns permits waiting for `loop`: all those of the oldest learner epoch and version of the weights. Blocks while
  // there are none, for at most `timeout`. Empty: there are still none, or Close was called.
  std::vector<HeldPermit> Take(int loop, absl::Duration timeout = absl::InfiniteDuration()) ABSL_LOCKS_EXCLUDED(mu_);
  // Releases a permit that is settled or will not be played. If no loop has taken it yet, none will.
  void Release(const HeldPermit& permit) ABSL_LOCKS_EXCLUDED(mu_);
  // All held permits, taken or not.
  std::vector<HeldPermit> Active() const ABSL_LOCKS_EXCLUDED(mu_);
  // Releases a permit and stores the reason, to be reported to the learner.
  void Fail(const HeldPermit& permit, const std::string& reason) ABSL_LOCKS_EXCLUDED(mu_);
  // The permits that failed in `epoch` and are not yet reported, at most one per lane. Those of other epochs are
  // forgotten.
  std::vector<HeldPermit> Failures(int64_t epoch) ABSL_LOCKS_EXCLUDED(mu_);
  // Marks failures as received by the learner.
  void SetReported(const std::vector<HeldPermit>& failures) ABSL_LOCKS_EXCLUDED(mu_);
  // Drops every permit that no loop has taken yet.
  void DropWaiting() ABSL_LOCKS_EXCLUDED(mu_);
  // Waits until Close is called, at most `timeout`.
  void WaitForClose(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);
  // Wakes every loop for good. Idempotent.
  void Close() ABSL_LOCKS_EXCLUDED(mu_);
  bool closed() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  size_t LoopOf(int lane) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ReleaseLocked(const HeldPermit& permit) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  mutable Mutex mu_;
  CondVar changed_;
  int tile_ ABSL_GUARDED_BY(mu_) = 1;
  int loops_ ABSL_GUARDED_BY(mu_);
  std::set<HeldPermit> active_ ABSL_GUARDED_BY(mu_);
  std::vector<std::vector<HeldPermit>> waiting_ ABSL_GUARDED_BY(mu_);  // by loop
  std::map<int, HeldPermit> failed_ ABSL_GUARDED_BY(mu_);              // by lane
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet
