// How long steps take on each environment server of an actor, and which servers are slow.

#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include <absl/time/time.h>

namespace craftfleet {

// A server's typical step time is the mean over some seconds: a mean, so that a server that stops again and again
// counts as slow although most of its steps are quick. Not thread-safe.
class StepTimes {
 public:
  static constexpr absl::Duration kWindow = absl::Seconds(3);
  static constexpr int kSeveral = 3;  // a slow server takes at least this many times as long as the others
  static constexpr absl::Duration kNeverSlow = absl::Milliseconds(10);
  // Where all servers are alike, or there is only one: slow in any case, or if it was several times faster before.
  static constexpr absl::Duration kAlwaysSlow = absl::Milliseconds(250);
  static constexpr absl::Duration kSlowerThanBefore = absl::Milliseconds(50);

  // A step on `server`, of any number of games, took `time` and ended at `now`. Returns whether this ended a window, so
  // that the typical time is new.
  bool Add(const std::string& server, absl::Duration time, absl::Time now);
  // The typical time in the last window that ended; nullopt: none has.
  std::optional<absl::Duration> TypicalOf(const std::string& server) const;
  // The median of the typical times of all servers but this one; nullopt: none is known.
  std::optional<absl::Duration> OthersOf(const std::string& server) const;
  // Whether a server with this typical time is several times slower than the others.
  bool IsSlowerThanOthers(const std::string& server, absl::Duration typical) const;
  // The same, or slow compared with its own best time or with what any step should take.
  bool IsSlow(const std::string& server, absl::Duration typical) const;
  // The server's typical time no longer counts.
  void Reset(const std::string& server);
  // Nor does its best time.
  void Forget(const std::string& server) { servers_.erase(server); }

 private:
  struct Server {
    absl::Time begun = absl::InfiniteFuture();  // the current window
    absl::Duration total;
    int64_t steps = 0;
    std::optional<absl::Duration> typical;
    absl::Duration best = absl::InfiniteDuration();
  };

  std::map<std::string, Server> servers_;  // by address
};

}  // namespace craftfleet
