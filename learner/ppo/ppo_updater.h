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
#include "learner/ppo/minibatches.h"
#include "learner/ppo/ppo_loss.h"
#include "learner/ppo/rollout.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// One iteration in numbers: means over its minibatches, but where it says otherwise.
struct UpdateStats {
  double policy_loss = 0;
  double value_loss = 0;          // mean squared error, of normalised values where values are
  double entropy = 0;             // nats
  double clip_fraction = 0;       // of rows whose probability ratio left 1 +- clip
  double gradient_norm = 0;       // L2, before clipping
  double approx_kl = 0;           // of the last epoch
  double explained_variance = 0;  // 1 - Var(returns - values) / Var(returns) of the rollout; 0 if returns are constant
};

// Owns the weights, Adam's state and the value normaliser of a training run. Each minibatch is cut into
// `gradient_shards` parts (CutIntoShards) whose gradients are computed apart, each by one thread, and added in order:
// the number of threads does not change a bit. Owned by one thread, which computes as well.
class PpoUpdater {
 public:
  // The fields of `config` that count: agent, network, seed, gradient_shards and ppo, all valid (ValidateRunConfig).
  // Starts from InitialWeights of the seed. `threads` >= 1; more than gradient_shards help little. `device`, as
  // FindDevice gives it, computes gradients; what is not worth a GPU (loss, Adam, minibatches) stays on the CPU.
  //   InvalidArgument: unknown agent; minibatch_size is not a multiple of gradient_shards.
  static absl::StatusOr<std::unique_ptr<PpoUpdater>> Create(const v1::RunConfig& config, int threads,
                                                            const std::string& device = "cpu");
  ~PpoUpdater();
  PpoUpdater(const PpoUpdater&) = delete;
  PpoUpdater& operator=(const PpoUpdater&) = delete;

  // How fragments that the present weights played become a rollout.
  RolloutOptions rollout_options() const;

  // Runs the epochs of `iteration`, which orders the minibatches. `should_stop` is asked after each minibatch.
  // Unless OK, weights, optimiser and value normaliser are as before.
  //   InvalidArgument: the rollout is empty, or the agent feed-forward and its size not a multiple of minibatch_size.
  //   Cancelled: should_stop() said so.   DataLoss: gradient or weights are not finite.   Internal: LibTorch failed.
  absl::StatusOr<UpdateStats> Update(int64_t iteration, const Rollout& rollout,
                                     const std::function<bool()>& should_stop);

  // Safetensors of the weights; of Adam's moments ("exp_avg.<name>", "exp_avg_sq.<name>"), its step count (metadata
  // "steps") and, where values are normalised, the normaliser ("value_norm.mean", ".mean_square" and ".weight").
  std::string SaveWeights() const;
  std::string SaveOptimizer() const;

  // Goes on from what SaveWeights and SaveOptimizer gave, bit for bit.
  //   InvalidArgument: not this agent's; names the tensor. Nothing is changed.
  absl::Status Load(absl::string_view weights, absl::string_view optimizer);

  // Begins with weights that SaveWeights gave, maybe of another run, and a fresh optimiser. The value normaliser,
  // without which the weights' values mean nothing, is taken from the `optimizer` that was saved with them, if it has
  // one.
  //   As Load.
  absl::Status StartFrom(absl::string_view weights, absl::string_view optimizer);

  const AgentSpec& spec() const { return spec_; }
  int64_t optimizer_steps() const { return state_.adam.steps; }

 private:
  struct Shard;  // one replica: net, gradients, input
  struct Batch;  // a minibatch, cut for the shards, with its targets
  struct State {
    std::vector<float> weights;  // [param_count]; the shards' nets look into it
    AdamState adam;
    ValueNorm value_norm;
  };

  PpoUpdater(AgentSpec spec, const v1::RunConfig& config, int threads, const std::string& device);

  // The minibatches of an epoch, as the agent wants them.
  std::vector<Minibatch> MakeMinibatches(const EpochKey& key, const Rollout& rollout) const;
  absl::StatusOr<UpdateStats> RunEpochs(int64_t iteration, const Rollout& rollout,
                                        const std::function<bool()>& should_stop);
  // One optimiser step; adds what it saw to `stats` and returns the means of its losses.
  absl::StatusOr<PpoLossSums> RunMinibatch(const Rollout& rollout, const Minibatch& minibatch, UpdateStats* stats);
  Batch MakeBatch(const Rollout& rollout, const Minibatch& minibatch);
  void Restore(State state);
  bool IsFinite() const;
  // Forward and backward of the batch's part number `part`.
  void ComputeGradient(const Rollout& rollout, const Batch& batch, size_t part, Shard* shard);

  const AgentSpec spec_;
  const v1::PpoConfig config_;
  const uint64_t seed_;
  const std::vector<uint8_t> no_frame_;  // [frame_bytes] zeros, for padding
  WorkerPool workers_;
  State state_;
  std::vector<std::unique_ptr<Shard>> shards_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_PPO_UPDATER_H_
