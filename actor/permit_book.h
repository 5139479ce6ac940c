// The permits that an actor holds, between the thread that asks for them and the loops that play.

#ifndef CRAFTFLEET_ACTOR_PERMIT_BOOK_H_
#define CRAFTFLEET_ACTOR_PERMIT_BOOK_H_

#include <cstddef>
#include <cstdint>
#include <set>
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

// A lane's permits always go to the same loop, lanes of one tile to one loop. Thread-safe.
class PermitBook {
 public:
  explicit PermitBook(int loops) : waiting_(loops) {}

  // How lanes are spread over loops: set by the run's configuration.
  void SetTile(int tile) ABSL_LOCKS_EXCLUDED(mu_);

  void Add(const HeldPermit& permit) ABSL_LOCKS_EXCLUDED(mu_);
  // Everything that waits for `loop`; blocks while there is nothing. Empty: Close was called.
  std::vector<HeldPermit> Take(int loop) ABSL_LOCKS_EXCLUDED(mu_);
  // The fragment was answered for, or will not be played by us: a loop that has not taken it won't.
  void Release(const HeldPermit& permit) ABSL_LOCKS_EXCLUDED(mu_);
  // All permits at hand, taken or not.
  std::vector<HeldPermit> Active() const ABSL_LOCKS_EXCLUDED(mu_);
  // Drops every permit that no loop has taken yet.
  void DropWaiting() ABSL_LOCKS_EXCLUDED(mu_);
  // Waits up to `timeout`, less if Close is called.
  void WaitForClose(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);
  // Wakes every loop for good. Idempotent.
  void Close() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  size_t LoopOf(int lane) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  mutable Mutex mu_;
  CondVar changed_;
  int tile_ ABSL_GUARDED_BY(mu_) = 1;
  std::set<HeldPermit> active_ ABSL_GUARDED_BY(mu_);
  std::vector<std::vector<HeldPermit>> waiting_ ABSL_GUARDED_BY(mu_);  // by loop
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_PERMIT_BOOK_H_
