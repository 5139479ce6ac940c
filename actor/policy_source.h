// Fetches the policy of a given version when needed.

#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <absl/status/statusor.h>

#include "actor/learner_client.h"
#include "common/agent/agent_spec.h"
#include "common/agent/policy.h"
#include "common/agent/policy_weights.h"
#include "common/base/mutex.h"

namespace craftfleet {

// A version of the weights.
using VersionedWeights = std::pair<int64_t, std::shared_ptr<const PolicyWeights>>;

// The weights of a learner in the same process, shared instead of received by calls. Thread-safe.
struct LocalWeights {
  // Those of `version` if it keeps them, otherwise the latest, which may be older; (-1, null): it has published none.
  std::function<VersionedWeights(int64_t version)> find;
  // Those that evaluation task `id` plays with; null: the task is over.
  std::function<std::shared_ptr<const PolicyWeights>(int64_t id)> find_of_evaluation;
};

// Keeps the last policy. Thread-safe: one thread fetches while the others wait for it.
class PolicySource {
 public:
  // Policies compute tiles of `tile` rows on `device` (Policy::Create). Without `local` weights it calls the learner.
  PolicySource(const LearnerClient* learner, AgentSpec spec, int tile, std::string device = "cpu",
               std::optional<LocalWeights> local = std::nullopt);

  // The policy of exactly `version` in learner epoch `epoch`, since a restarted learner may compute other weights.
  //   Aborted: the learner has another version.   Others as LearnerClient::GetWeights and Policy::Create.
  absl::StatusOr<std::shared_ptr<const Policy>> Get(int64_t epoch, int64_t version) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  absl::StatusOr<VersionedWeights> GetWeights(int64_t version) const;
  // Fetches and makes the policy of `version`, or of the version that there is.
  absl::StatusOr<std::pair<int64_t, std::shared_ptr<const Policy>>> Fetch(int64_t version) const;

  const LearnerClient* const learner_;
  const AgentSpec spec_;
  const int tile_;
  const std::string device_;
  const std::optional<LocalWeights> local_;

  Mutex mu_;
  CondVar fetched_;
  bool fetching_ ABSL_GUARDED_BY(mu_) = false;  // a thread, without the lock
  int64_t epoch_ ABSL_GUARDED_BY(mu_) = -1;
  int64_t version_ ABSL_GUARDED_BY(mu_) = -1;
  std::shared_ptr<const Policy> policy_ ABSL_GUARDED_BY(mu_);
};

}  // namespace craftfleet
