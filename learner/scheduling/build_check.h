// Checks that workers compute the same numbers and play the same game as this learner's build.

#pragma once

#include <cstdint>
#include <string>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

#include "learner/scheduling/worker.h"

namespace craftfleet {

// Compares canaries. With a worker that differs, the result would depend on which worker plays, so it is refused,
// unless `allow_mixed`. Not thread-safe: WorkerRegistry calls it under its mutex.
class BuildCheck {
 public:
  struct Options {
    std::string build;          // this learner's, for messages
    std::string policy_canary;  // required of actors; empty: any
    std::string game_canary;    // required of environment servers; empty: any
    bool allow_mixed = false;   // accept workers that differ
  };

  explicit BuildCheck(const Options& options) : options_(options) {}

  // Compares `build`, reported by `worker`, and stores in `worker` whether it differs.
  //   FailedPrecondition: it differs; the message has the remedy. The caller logs it. With `allow_mixed` a warning is
  //   logged once for each build instead.
  absl::Status Check(const WorkerBuild& build, absl::Time now, Worker* worker);

  // The canary that actors require of environment servers; empty: any.
  std::string GameCanary() const { return options_.allow_mixed ? "" : options_.game_canary; }

  bool allow_mixed() const { return options_.allow_mixed; }
  // How often a worker that differs was refused or, with `allow_mixed`, accepted.
  int64_t differing() const { return differing_; }

 private:
  const Options options_;
  std::string warned_;  // build that was last accepted with a warning
  int64_t differing_ = 0;
};

}  // namespace craftfleet
