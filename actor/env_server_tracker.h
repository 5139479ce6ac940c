// The state of an actor's environment servers, for status pages.

#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include <absl/time/time.h>

#include "common/base/mutex.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// Combines the reports of all loops. Thread-safe.
class EnvServerTracker {
 public:
  struct Server {
    std::string address;
    bool connected = false;
    int lanes = 0;               // the loop's games there
    v1::ProcessSummary summary;  // as the server last reported it; empty: not for some seconds
    std::string error;           // why it gets no games, or why only for want of others; empty: it answers
    bool slow = false;           // that is why
    absl::Duration step_time = absl::ZeroDuration();  // typical time of a step; zero: not known
  };

  // Replaces the report of loop number `loop`.
  void Update(int loop, std::vector<Server> servers) ABSL_LOCKS_EXCLUDED(mu_);

  // All servers, as peers: OK if reached by at least one loop, SLOW, NOT_ANSWERING, or LOST. Servers without games of
  // this actor have no summary.
  std::vector<v1::Peer> All() const ABSL_LOCKS_EXCLUDED(mu_);
  // At most `count` of them; each call continues where the last one ended.
  std::vector<v1::Peer> Next(size_t count) ABSL_LOCKS_EXCLUDED(mu_);
  // The same, only with servers that are SLOW, NOT_ANSWERING or LOST.
  std::vector<v1::Peer> NextUnusable(size_t count) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // At most `count` of `all`, starting after the last one of the previous call.
  std::vector<v1::Peer> Rotate(std::vector<v1::Peer> all, size_t count) ABSL_LOCKS_EXCLUDED(mu_);

  mutable Mutex mu_;
  std::map<int, std::vector<Server>> reports_ ABSL_GUARDED_BY(mu_);  // by loop
  std::string last_ ABSL_GUARDED_BY(mu_);                            // address where Rotate ended
};

}  // namespace craftfleet
