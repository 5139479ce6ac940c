// The environment servers that announced themselves.

#ifndef CRAFTFLEET_LEARNER_SERVER_REGISTRY_H_
#define CRAFTFLEET_LEARNER_SERVER_REGISTRY_H_

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/clock.h"
#include "common/mutex.h"

namespace craftfleet {

// One server an address: one that comes back at the address of another takes its place, since that one is gone. A
// server that has said nothing for `lease` is forgotten. Thread-safe.
class ServerRegistry {
 public:
  struct Server {
    std::string name;
    std::string address;
    absl::Duration idle;  // since its last word
    bool draining = false;
  };

  // `clock` outlives the registry.
  ServerRegistry(absl::Duration lease, Clock* clock)
      : lease_(lease),
        clock_(clock),
        start_(clock->Now()),
        first_generation_(absl::ToUnixMicros(clock->WallNow())),
        generation_(first_generation_) {}

  // `lanes`: games that it has.
  void Announce(absl::string_view name, absl::string_view address, int lanes = 0) ABSL_LOCKS_EXCLUDED(mu_);
  void Leave(absl::string_view name) ABSL_LOCKS_EXCLUDED(mu_);

  // From now on server `name` is none of Servers.
  void Drain(absl::string_view name) ABSL_LOCKS_EXCLUDED(mu_);
  // It is and has said since that it has no game, or it is gone.
  bool IsDrained(absl::string_view name) ABSL_LOCKS_EXCLUDED(mu_);

  // As of Servers, at most a second old: cheap, however many servers there are.
  int64_t Generation() ABSL_LOCKS_EXCLUDED(mu_);

  // Those that take games, by address. `generation`, if not null, becomes another number, above 0, whenever the
  // addresses have changed, also over restarts of the learner.
  std::vector<Server> Servers(int64_t* generation = nullptr) ABSL_LOCKS_EXCLUDED(mu_);

  // Whether an actor that has the addresses of `generation` (0: none) should keep them: they are from before the
  // learner's start, and not every server has had the time to announce itself again.
  bool ShouldKeep(int64_t generation) const {
    return generation != 0 && generation < first_generation_ && clock_->Now() - start_ < lease_;
  }

  // With those that are being drained.
  std::vector<Server> All() ABSL_LOCKS_EXCLUDED(mu_);

  absl::Duration lease() const { return lease_; }

 private:
  struct Entry {
    std::string name;
    absl::Time last_word;
    bool draining = false;
    bool empty = false;  // as it said since it is drained
  };

  std::map<std::string, Entry, std::less<>>::iterator Find(absl::string_view name) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  std::vector<Server> List(bool with_draining) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ForgetIdle() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The same once a second: there may be thousands of servers.
  void ForgetIdleNowAndThen() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const absl::Duration lease_;
  Clock* const clock_;
  const absl::Time start_;
  const int64_t first_generation_;  // the date in microseconds: above those of earlier starts
  Mutex mu_;
  int64_t generation_ ABSL_GUARDED_BY(mu_);
  std::map<std::string, Entry, std::less<>> servers_ ABSL_GUARDED_BY(mu_);  // by address
  absl::Time looked_ ABSL_GUARDED_BY(mu_) = absl::InfinitePast();           // for idle ones
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_SERVER_REGISTRY_H_
