// Fetches the policy of a given version when needed.

#ifndef CRAFTFLEET_ACTOR_POLICY_SOURCE_H_
#define CRAFTFLEET_ACTOR_POLICY_SOURCE_H_

#include <cstdint>
#include <memory>
#include <string>

#include <absl/status/statusor.h>

#include "actor/learner_client.h"
#include "common/agent/agent_spec.h"
#include "common/agent/policy.h"
#include "common/base/mutex.h"

namespace craftfleet {

// Keeps the last policy. Thread-safe: one thread fetches while the others wait for it.
class PolicySource {
 public:
  // Policies compute tiles of `tile` rows on `device` (Policy::Create).
  PolicySource(const LearnerClient* learner, AgentSpec spec, int tile, std::string device = "cpu");

  // The policy of exactly `version` in learner epoch `epoch`, since a restarted learner may compute other weights.
  //   Aborted: the learner has a later version.   Others as LearnerClient::GetWeights and Policy::Create.
  absl::StatusOr<std::shared_ptr<const Policy>> Get(int64_t epoch, int64_t version) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  const LearnerClient* const learner_;
  const AgentSpec spec_;
  const int tile_;
  const std::string device_;

  Mutex mu_;
  int64_t epoch_ ABSL_GUARDED_BY(mu_) = -1;
  int64_t version_ ABSL_GUARDED_BY(mu_) = -1;
  std::shared_ptr<const Policy> policy_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_ACTOR_POLICY_SOURCE_H_
