// Whether workers compute and play what this learner's build does.

#ifndef CRAFTFLEET_LEARNER_BUILD_CHECK_H_
#define CRAFTFLEET_LEARNER_BUILD_CHECK_H_

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <utility>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "common/clock.h"
#include "common/mutex.h"
#include "craftfleet/v1/learner.pb.h"
#include "craftfleet/v1/status.pb.h"

namespace craftfleet {

// Compares canaries. A worker that differs would make the run's result depend on who plays, so it is refused, unless
// `allow_mixed`, and named on the status page. Thread-safe.
class BuildCheck {
 public:
  static constexpr absl::Duration kRemember = absl::Minutes(10);  // who differed
  static constexpr size_t kMaxRemembered = 16;

  struct Options {
    std::string build;          // this learner's, for messages
    std::string policy_canary;  // what actors must show; empty: anything
    std::string game_canary;    // what environment servers must show; empty: what the first of them shows
    bool allow_mixed = false;   // who differs is let in
  };

  // `clock` outlives the object.
  BuildCheck(const Options& options, Clock* clock)
      : options_(options), clock_(clock), game_canary_(options.game_canary) {}

  // FailedPrecondition: it differs; says what to do. Logged by who calls; with `allow_mixed` a warning is logged once
  // for each build.
  absl::Status CheckActor(const v1::JoinRequest& request) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status CheckServer(const v1::Announcement& announcement) ABSL_LOCKS_EXCLUDED(mu_);

  // What actors want of environment servers; empty: anything.
  std::string GameCanary() const ABSL_LOCKS_EXCLUDED(mu_);

  // Says of the workers in `reply` that differ, and adds those that were refused.
  void FillStatus(v1::StatusReply* reply) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Worker {
    absl::string_view role;  // "actor", "envserver"
    absl::string_view name;
    absl::string_view address;
    std::string build;  // for messages
    std::string shown;  // its canary, or that it has none
    std::string does;   // what differs
    absl::string_view remedy;
  };
  struct Different {
    std::string address;
    std::string build;
    absl::Time last_word;
  };
  using Key = std::pair<std::string, std::string>;  // role, name

  absl::Status Differs(const Worker& worker, absl::string_view want) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const Options options_;
  Clock* const clock_;
  mutable Mutex mu_;
  std::string game_canary_ ABSL_GUARDED_BY(mu_);
  std::map<Key, Different> different_ ABSL_GUARDED_BY(mu_);
  std::string warned_ ABSL_GUARDED_BY(mu_);  // build that was last let in with a warning
  int64_t count_ ABSL_GUARDED_BY(mu_) = 0;   // times that one was refused, or let in
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_BUILD_CHECK_H_
