#include "actor/policy_source.h"

#include <string>
#include <utility>

#include <absl/strings/str_format.h>

#include "common/agent/weights.h"
#include "common/base/status_macros.h"
#include "common/process/heap.h"

namespace craftfleet {

PolicySource::PolicySource(const LearnerClient* learner, AgentSpec spec, int tile, std::string device,
                           LocalWeights local)
    : learner_(learner), spec_(std::move(spec)), tile_(tile), device_(std::move(device)), local_(std::move(local)) {}

absl::StatusOr<VersionedWeights> PolicySource::GetWeights(int64_t version) const {
  if (local_ != nullptr) {
    VersionedWeights weights = local_(version);
    if (weights.second == nullptr) return absl::AbortedError("the learner has published no weights yet");
    return weights;
  }
  CRAFTFLEET_ASSIGN_OR_RETURN(auto weights, learner_->GetWeights(version, MaxWeightsBytes(spec_)));
  return VersionedWeights(weights.first, std::make_shared<const std::string>(std::move(weights.second)));
}

absl::StatusOr<std::shared_ptr<const Policy>> PolicySource::Get(int64_t epoch, int64_t version) {
  MutexLock lock(&mu_);
  if (epoch_ == epoch && version_ == version) return policy_;
  CRAFTFLEET_ASSIGN_OR_RETURN(const VersionedWeights weights, GetWeights(version));
  const auto& [fetched, bytes] = weights;
  CRAFTFLEET_ASSIGN_OR_RETURN(policy_, Policy::Create(spec_, *bytes, tile_, device_));
  epoch_ = epoch;
  version_ = fetched;
  ReleaseFreeMemory();  // of the previous iteration's fragments and policy
  if (fetched != version) {
    return absl::AbortedError(absl::StrFormat("weights are at version %d, the permit is for %d", fetched, version));
  }
  return policy_;
}

}  // namespace craftfleet
