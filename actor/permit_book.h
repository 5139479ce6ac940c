// The permits that an actor holds, between the thread that asks for them and the loops that play.

#ifndef CRAFTFLEET_ACTOR_PERMIT_BOOK_H_
#define CRAFTFLEET_ACTOR_PERMIT_BOOK_H_

#include <cstddef>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include <absl/time/time.h>

#include "common/mutex.h"

namespace craftfleet {

// Leave to collect one fragment (learner.proto).
struct HeldPermit {
  int64_t epoch = 0;  // learner epoch that gave it
  int lane = 0;
  int64_t fragment = 0;
  int64_t policy_version = 0;
  friend bool operator==(const HeldPermit& a, const HeldPermit& b) {
    return std::tie(a.epoch, a.lane, a.fragment, a.policy_version) ==
           std::tie(b.epoch, b.lane, b.fragment, b.policy_version);
  }
  friend bool operator<(const HeldPermit& a, const HeldPermit& b) {
    return std::tie(a.epoch, a.lane, a.fragment, a.policy_version) <
           std::tie(b.epoch, b.lane, b.fragment, b.policy_version);
  }
};

// How far a permit's fragment is.
struct PermitProgress {
  HeldPermit permit;
  int64_t steps = 0;  // played
};

// A permit whose lane can't be played, since its snapshot is no game.
struct FailedPermit {
  HeldPermit permit;
  std::string reason;
};

// A lane's permits always go to the same loop, lanes of one tile to one loop. Thread-safe.
class PermitBook {
 public:
  explicit PermitBook(int loops) : waiting_(loops), playing_(loops), steps_(loops) {}

  // How lanes are spread over loops: set by the run's configuration.
  void SetTile(int tile) ABSL_LOCKS_EXCLUDED(mu_);

  void Add(const HeldPermit& permit) ABSL_LOCKS_EXCLUDED(mu_);
  // Everything that waits for `loop`; blocks while there is nothing. Empty: Close was called.
  std::vector<HeldPermit> Take(int loop) ABSL_LOCKS_EXCLUDED(mu_);
  // The fragment was answered for, or will not be played by us: a loop that has not taken it won't.
  void Release(const HeldPermit& permit) ABSL_LOCKS_EXCLUDED(mu_);
  // All permits at hand, taken or not.
  std::vector<HeldPermit> Active() const ABSL_LOCKS_EXCLUDED(mu_);
  // The same with the steps that were played of each.
  std::vector<PermitProgress> Progress() const ABSL_LOCKS_EXCLUDED(mu_);
  // `loop` has played `steps` of each fragment that it took last.
  void SetSteps(int loop, int64_t steps) ABSL_LOCKS_EXCLUDED(mu_);
  // Releases a permit and keeps why, to be told to the learner.
  void Fail(const HeldPermit& permit, const std::string& reason) ABSL_LOCKS_EXCLUDED(mu_);
  // What failed in `epoch` and was not told yet; what failed in others is forgotten. At most one for each lane.
  std::vector<FailedPermit> Failures(int64_t epoch) ABSL_LOCKS_EXCLUDED(mu_);
  // The learner knows of these.
  void Told(const std::vector<FailedPermit>& failures) ABSL_LOCKS_EXCLUDED(mu_);
  // Drops every permit that no loop has taken yet.
  void DropWaiting() ABSL_LOCKS_EXCLUDED(mu_);
  // Waits up to `timeout`, less if Close is called.
  void WaitForClose(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);
  // Wakes every loop for good. Idempotent.
  void Close() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  size_t LoopOf(int lane) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ReleaseLocked(const HeldPermit& permit) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  mutable Mutex mu_;
  CondVar changed_;
  int tile_ ABSL_GUARDED_BY(mu_) = 1;
  std::map<HeldPermit, int64_t> active_ ABSL_GUARDED_BY(mu_);          // steps of fragments that are played to the end
  std::vector<std::vector<HeldPermit>> waiting_ ABSL_GUARDED_BY(mu_);  // by loop
  std::vector<std::set<HeldPermit>> playing_ ABSL_GUARDED_BY(mu_);     // what each loop took last
  std::vector<int64_t> steps_ ABSL_GUARDED_BY(mu_);                    // of those, by loop
  std::map<int, FailedPermit> failed_ ABSL_GUARDED_BY(mu_);            // by lane
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_PERMIT_BOOK_H_
