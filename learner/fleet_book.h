// What is known of every worker of the fleet, for status pages.

#ifndef CRAFTFLEET_LEARNER_FLEET_BOOK_H_
#define CRAFTFLEET_LEARNER_FLEET_BOOK_H_

#include <map>
#include <string>
#include <utility>
#include <vector>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/clock.h"
#include "common/mutex.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// Remembers workers a while after they went, so that a page shows who is missing; decides nothing. Thread-safe.
class FleetBook {
 public:
  static constexpr absl::Duration kRememberLost = absl::Minutes(10);
  static constexpr absl::Duration kRememberLeft = absl::Minutes(1);
  static constexpr int kMaxGone = 64;  // workers that are lost or have left; the newest are kept

  // A worker silent for `lease` is LOST. `clock` outlives the book.
  FleetBook(absl::Duration lease, Clock* clock) : lease_(lease), clock_(clock) {}

  // Worker `name` of `role`, "actor" or "envserver", spoke. An empty `summary` or `address` leaves what it said before.
  void Heard(absl::string_view role, absl::string_view name, absl::string_view address,
             const v1::ProcessSummary& summary) ABSL_LOCKS_EXCLUDED(mu_);
  // An actor spoke of an environment server. Counts for servers that don't speak for themselves; that it does not
  // answer counts for all.
  void HeardOf(const v1::Peer& server) ABSL_LOCKS_EXCLUDED(mu_);
  // It said goodbye.
  void Left(absl::string_view role, absl::string_view name) ABSL_LOCKS_EXCLUDED(mu_);

  // All of them: actors first, then environment servers, each by name.
  std::vector<v1::Peer> Workers() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Worker {
    std::string address;
    v1::ProcessSummary summary;
    absl::Time summary_time = absl::InfinitePast();
    absl::Time last_word;                        // its own, or an actor's that reaches it
    absl::Time own_word = absl::InfinitePast();  // its own
    absl::Time hung_at = absl::InfinitePast();   // when an actor said last that it does not answer
    bool left = false;
  };
  using Key = std::pair<std::string, std::string>;  // role, name

  v1::Peer::Health HealthOf(const Worker& worker) const;
  // Forgets who went long ago, and the oldest of too many. Looks at all, so not at each word of thousands of workers
  // but when a new one comes: without those the book does not grow.
  void Forget() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const absl::Duration lease_;
  Clock* const clock_;
  mutable Mutex mu_;
  std::map<Key, Worker> workers_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_FLEET_BOOK_H_
