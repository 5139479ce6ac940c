#include "actor/policy_source.h"

#include <string>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/agent/weights.h"
#include "common/base/status_macros.h"
#include "common/process/heap.h"

namespace craftfleet {

PolicySource::PolicySource(const LearnerClient* learner, AgentSpec spec, int tile, std::string device,
                           std::optional<LocalWeights> local)
    : learner_(learner), spec_(std::move(spec)), tile_(tile), device_(std::move(device)), local_(std::move(local)) {}

absl::StatusOr<VersionedWeights> PolicySource::GetWeights(int64_t version) const {
  if (local_.has_value()) {
    VersionedWeights weights = local_->find(version);
    if (weights.second == nullptr) return absl::AbortedError("the learner has published no weights yet");
    return weights;
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(auto weights, learner_->GetWeights(version, MaxWeightsBytes(spec_)));
  return VersionedWeights(weights.first, std::make_shared<const HostWeights>(std::move(weights.second)));
}

absl::StatusOr<std::pair<int64_t, std::shared_ptr<const Policy>>> PolicySource::Fetch(int64_t version) const {
  CRAFTFLEET_ASSIGN_OR_RETURN(const VersionedWeights weights, GetWeights(version));
  CRAFTFLEET_ASSIGN_OR_RETURN(std::shared_ptr<const Policy> policy,
                              Policy::Create(spec_, weights.second, tile_, device_));
  return std::make_pair(weights.first, std::move(policy));
}

absl::StatusOr<std::shared_ptr<const Policy>> PolicySource::Get(int64_t epoch, int64_t version) {
  {
    const MutexLock lock(&mu_);
    fetched_.Wait(&mu_, [this]() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return !fetching_; });
    if (epoch_ == epoch && version_ == version) return policy_;
    fetching_ = true;
  }
  auto fetched = Fetch(version);
  const MutexLock lock(&mu_);
  fetching_ = false;
  fetched_.NotifyAll();
  CRAFTFLEET_RETURN_IF_ERROR(fetched.status());
  epoch_ = epoch;
  version_ = fetched->first;
  policy_ = std::move(fetched->second);
  ReleaseFreeMemory();  // of the previous iteration's fragments and policy
  if (version_ != version) {
    return absl::AbortedError(absl::StrFormat("weights are at version %d, the permit is for %d", version_, version));
  }
  return policy_;
}

}  // namespace craftfleet
