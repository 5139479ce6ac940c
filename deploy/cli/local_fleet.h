// Learner, actor and environment server in one process. They use the same code as a fleet, over in-process channels.

#pragma once

#include <memory>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

#include "actor/actor.h"
#include "common/wire/server.h"
#include "common/wire/status_service.h"
#include "envserver/env_service.h"
#include "learner/learner.h"

namespace craftfleet {

// Run is called once; Stop from any thread.
class LocalFleet {
 public:
  // If `options.server.address` is empty, the fleet does not listen. `env_timeout` is that of Actor::Options. Errors
  // are those of the parts.
  static absl::StatusOr<std::unique_ptr<LocalFleet>> Create(const Learner::Options& options,
                                                            absl::Duration env_timeout = kDefaultEnvTimeout);

  // Trains to the end or until Stop. Returns the first part's error.
  absl::Status Run();
  void Stop() {
    actor_->Stop();  // first, or it would wait for the learner to come back
    learner_->Stop();
  }

  Learner& learner() const { return *learner_; }
  const Actor& actor() const { return *actor_; }

 private:
  LocalFleet() = default;

  std::unique_ptr<EnvServiceImpl> env_service_;
  std::unique_ptr<wire::Server> env_server_;
  std::unique_ptr<Learner> learner_;
  std::unique_ptr<Actor> actor_;
};

}  // namespace craftfleet
