#include "deploy/cli/local_fleet.h"

#include <algorithm>
#include <thread>
#include <utility>

#include "common/base/status_macros.h"

namespace craftfleet {

absl::StatusOr<std::unique_ptr<LocalFleet>> LocalFleet::Create(const Learner::Options& options,
                                                               absl::Duration env_timeout) {
  std::unique_ptr<LocalFleet> fleet(new LocalFleet);
  CRAFTFLEET_ASSIGN_OR_RETURN(fleet->env_service_, EnvServiceImpl::Create(options.texture_dir));
  CRAFTFLEET_ASSIGN_OR_RETURN(fleet->env_server_, wire::Server::Create({}, {fleet->env_service_.get()}));
  CRAFTFLEET_ASSIGN_OR_RETURN(fleet->learner_, Learner::Create(options));
  Actor::Options actor;
  actor.frames = FrameFormat::kRaw;  // nothing travels: drawn once is enough
  actor.learner = fleet->learner_->InProcess();
  actor.weights = {[learner = fleet->learner_.get()](int64_t version) {
                     WeightStore::Weights weights = learner->FindWeights(version);
                     return VersionedWeights(weights.version, std::move(weights.weights));
                   },
                   [learner = fleet->learner_.get()](int64_t id) { return learner->FindEvaluationWeights(id); }};
  actor.env_servers = std::make_shared<EnvDirectory>(std::vector<wire::Endpoint>{fleet->env_server_->InProcess()});
  actor.threads = options.threads;
  const bool acts_on_gpu = fleet->learner_->config().device() == v1::RunConfig::CUDA;
  if (acts_on_gpu) actor.threads = std::max(actor.threads, 2);  // one group of lanes plays while the other is computed
  actor.find_device = [device = acts_on_gpu ? options.device : "cpu"](v1::RunConfig::Device) { return device; };
  actor.env_timeout = env_timeout;
  CRAFTFLEET_ASSIGN_OR_RETURN(fleet->actor_, Actor::Create(actor));
  return fleet;
}

absl::Status LocalFleet::Run() {
  absl::Status played;
  std::thread actor([this, &played] {
    played = actor_->Run(wire::kInProcess);
    // Without its only actor the learner would wait forever.
    if (!played.ok()) learner_->Stop();
  });
  const absl::Status trained = learner_->Run();
  actor_->Stop();
  actor.join();
  return trained.ok() ? played : trained;
}

}  // namespace craftfleet
