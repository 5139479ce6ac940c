// The environment servers that announced themselves.

#ifndef CRAFTFLEET_LEARNER_SERVER_REGISTRY_H_
#define CRAFTFLEET_LEARNER_SERVER_REGISTRY_H_

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/clock.h"
#include "common/mutex.h"

namespace craftfleet {

// A server that has said nothing for `lease` is forgotten. One that comes back at an address of another takes its
// place: that one is gone. Thread-safe.
class ServerRegistry {
 public:
  struct Server {
    std::string name;
    std::string address;
    absl::Duration idle;  // since its last word
  };

  // `clock` outlives the registry.
  ServerRegistry(absl::Duration lease, Clock* clock) : lease_(lease), clock_(clock) {}

  void Announce(absl::string_view name, absl::string_view address) ABSL_LOCKS_EXCLUDED(mu_);
  void Leave(absl::string_view name) ABSL_LOCKS_EXCLUDED(mu_);

  // By name. `generation`, if not null, becomes another number, above 0, whenever the addresses have changed.
  std::vector<Server> Servers(int64_t* generation = nullptr) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Entry {
    std::string address;
    absl::Time last_word;
  };

  void ForgetIdle() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const absl::Duration lease_;
  Clock* const clock_;
  Mutex mu_;
  std::map<std::string, Entry> servers_ ABSL_GUARDED_BY(mu_);
  int64_t generation_ ABSL_GUARDED_BY(mu_) = 1;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_SERVER_REGISTRY_H_
