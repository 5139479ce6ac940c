// Proximal policy optimisation (Schulman et al. 2017): from a rollout to the next weights.

#ifndef CRAFTFLEET_LEARNER_PPO_PPO_UPDATER_H_
#define CRAFTFLEET_LEARNER_PPO_PPO_UPDATER_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "common/agent/agent_spec.h"
#include "common/worker_pool.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/adam.h"
#include "learner/ppo/ppo_loss.h"
#include "learner/ppo/rollout.h"

namespace craftfleet {

// One iteration in numbers: means over its minibatches, but where it says otherwise.
struct UpdateStats {
  double policy_loss = 0;
  double value_loss = 0;          // mean squared error
  double entropy = 0;             // nats
  double clip_fraction = 0;       // of rows whose probability ratio left 1 +- clip
  double gradient_norm = 0;       // L2, before clipping
  double approx_kl = 0;           // of the last epoch
  double explained_variance = 0;  // 1 - Var(returns - values) / Var(returns) of the rollout; 0 if returns are constant
};

// Owns the weights and Adam's state of a training run. Each minibatch is cut into `gradient_shards` equal parts whose
// gradients are computed apart, each by one thread, and added in order: the number of threads does not change a bit.
// Owned by one thread, which computes as well.
class PpoUpdater {
 public:
  // The fields of `config` that count: agent, seed, gradient_shards and ppo, all valid (ValidateRunConfig). Starts from
  // InitialWeights of the seed. `threads` >= 1; more than gradient_shards help little.
  //   InvalidArgument: unknown agent; minibatch_size is not a multiple of gradient_shards.
  static absl::StatusOr<std::unique_ptr<PpoUpdater>> Create(const v1::RunConfig& config, int threads);
  ~PpoUpdater();
  PpoUpdater(const PpoUpdater&) = delete;
  PpoUpdater& operator=(const PpoUpdater&) = delete;

  // Runs the epochs of `iteration`, which orders the minibatches. `should_stop` is asked after each minibatch.
  // Unless OK, weights and optimiser are as before.
  //   InvalidArgument: the rollout's size is not a multiple of minibatch_size, or 0.
  //   Cancelled: should_stop() said so.   DataLoss: the gradient is not finite.   Internal: LibTorch failed.
  absl::StatusOr<UpdateStats> Update(int64_t iteration, const Rollout& rollout,
                                     const std::function<bool()>& should_stop);

  // Safetensors of the weights; of Adam's moments ("exp_avg.<name>", "exp_avg_sq.<name>") and its step count (metadata
  // "steps").
  std::string SaveWeights() const;
  std::string SaveOptimizer() const;

  // Goes on from what SaveWeights and SaveOptimizer gave, bit for bit.
  //   InvalidArgument: not this agent's; names the tensor. Nothing is changed.
  absl::Status Load(absl::string_view weights, absl::string_view optimizer);

  const AgentSpec& spec() const { return spec_; }
  int64_t optimizer_steps() const { return adam_.steps; }

 private:
  struct Shard;  // one replica: net, gradients, input

  PpoUpdater(AgentSpec spec, const v1::RunConfig& config, int threads);

  absl::StatusOr<UpdateStats> RunEpochs(int64_t iteration, const Rollout& rollout,
                                        const std::function<bool()>& should_stop);
  // One optimiser step on the `rows` of the rollout; adds what it saw to `stats` and returns the loss sums.
  absl::StatusOr<PpoLossSums> RunMinibatch(const Rollout& rollout, absl::Span<const int> rows, UpdateStats* stats);
  // Forward and backward of the shard's rows. `advantages` belong to `rows`, normalised.
  void ComputeGradient(const Rollout& rollout, absl::Span<const int> rows, absl::Span<const float> advantages,
                       Shard* shard);

  const AgentSpec spec_;
  const v1::PpoConfig config_;
  const uint64_t seed_;
  WorkerPool workers_;
  std::vector<float> weights_;  // [param_count]; the shards' nets look into it
  AdamState adam_;
  std::vector<std::unique_ptr<Shard>> shards_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_PPO_UPDATER_H_
