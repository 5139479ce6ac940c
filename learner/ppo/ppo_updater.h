// Proximal policy optimisation (Schulman et al. 2017): from a rollout to the next weights. Equations: PPO.md.

#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "common/agent/policy_weights.h"
#include "common/base/worker_pool.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/adam.h"
#include "learner/ppo/distillation/distiller.h"
#include "learner/ppo/gradient_shards.h"
#include "learner/ppo/lag_correction.h"
#include "learner/ppo/minibatches.h"
#include "learner/ppo/rank_sums.h"
#include "learner/ppo/rollout.h"
#include "learner/ppo/update_state.h"
#include "learner/ppo/update_stats.h"
#include "learner/ranks/rank_group.h"

namespace craftfleet {

class DeviceUpdate;

// Owns the weights, Adam's state and the value normaliser of a training run. Each minibatch is cut into
// `gradient_shards` parts (CutIntoShards) whose gradients are computed apart, each by one thread, and added in order:
// the number of threads does not change a bit. On a GPU, DeviceUpdate computes instead. Owned by one thread, which
// computes as well.
class PpoUpdater {
 public:
  enum class Start {
    kInitialWeights,  // InitialWeights of the seed
    kZeros,           // Load or StartFrom comes next: the initial weights of a large agent take seconds
  };

  // The fields of `config` that count: agent, network, seed, gradient_shards and ppo, all valid (ValidateRunConfig).
  // `threads` >= 1; more than gradient_shards help little. `device`, as
  // FindDevice returns it, computes; "cpu:0" is the CPU as if it were a GPU, for tests.
  //   InvalidArgument: unknown agent, or a precision that this device does not compute.
  static absl::StatusOr<std::unique_ptr<PpoUpdater>> Create(const v1::RunConfig& config, int threads,
                                                            const std::string& device = "cpu",
                                                            Start start = Start::kInitialWeights);
  ~PpoUpdater();
  PpoUpdater(const PpoUpdater&) = delete;
  PpoUpdater& operator=(const PpoUpdater&) = delete;

  // From now on computes only this rank's shards of each minibatch and adds them to those of the other ranks of
  // `group`, which has at most gradient_shards and outlives this. All of them have the same configuration, weights and
  // optimiser, and call Update with the same rollouts; they get the bytes of one process. Only rank 0's should_stop
  // counts. Distillation is not shared: each rank computes all of it. On the CPU only.
  void ShareOut(RankGroup* group);

  // How fragments that the present weights played become a rollout.
  RolloutOptions rollout_options() const;

  // Runs the epochs of `iteration`, which orders the minibatches, and distillation after them. `should_stop` is asked
  // after each minibatch. Unless OK, weights, optimiser and value normaliser are as before. The rollout is not empty,
  // and of feed-forward agents a multiple of minibatch_size.
  //   Cancelled: should_stop() said so.   DataLoss: gradient or weights are not finite, training diverges
  //   (divergence.h), or a rank has other weights than rank 0.   Internal: LibTorch failed.   Others, on a GPU, as
  //   DeviceUpdate::Run; with ranks, as RankGroup.
  absl::StatusOr<UpdateStats> Update(int64_t iteration, const Rollout& rollout,
                                     const std::function<bool()>& should_stop);

  // The weights, for several users: made once as long as they stay. On a device they stay in its memory.
  std::shared_ptr<const PolicyWeights> ShareWeights();

  // Safetensors of the weights; of Adam's moments ("exp_avg.<name>", "exp_avg_sq.<name>"), its step count (metadata
  // "steps") and, where values are normalised, the normaliser ("value_norm.mean", ".mean_square" and ".weight"). With
  // distillation, also its Adams' ("matching.exp_avg.<name>", ...) and the kept rollouts (FORMATS.md, section 7).
  //   On a GPU as DeviceError (common/agent/device.h).
  absl::StatusOr<std::string> SaveWeights() const;
  absl::StatusOr<std::string> SaveOptimizer();

  // Continues from the results of SaveWeights and SaveOptimizer, bit for bit.
  //   InvalidArgument: not this agent's; names the tensor. Nothing is changed.
  absl::Status Load(absl::string_view weights, absl::string_view optimizer);

  // Begins with the result of SaveWeights, maybe of another run, and a fresh optimiser. The value normaliser,
  // without which the weights' values mean nothing, is taken from the `optimizer` that was saved with them, if it has
  // one.
  //   As Load.
  absl::Status StartFrom(absl::string_view weights, absl::string_view optimizer);

  const AgentSpec& spec() const { return spec_; }
  int64_t optimizer_steps() const { return state_.adam.steps; }

 private:
  using State = UpdateState;

  PpoUpdater(AgentSpec spec, const v1::RunConfig& config, int threads, const std::string& device, Start start);

  // All optimisers without a step.
  State FreshState(std::vector<float> weights) const;

  // Gives all ranks' outputs to all, where each has those of its own rows and zeros.
  absl::Status Combine(StartOutputs* start);
  ValueScale value_scale() const;
  // The minibatches of an epoch, by the kind of agent.
  std::vector<Minibatch> MakeMinibatches(const EpochKey& key, const Rollout& rollout) const;
  absl::StatusOr<UpdateStats> UpdateOnDevice(int64_t iteration, const Rollout& rollout,
                                             const std::function<bool()>& should_stop);
  // From the first epoch on `*rollout`, or on what becomes of it in `corrected`, which it then points to.
  absl::StatusOr<UpdateStats> RunEpochs(int64_t iteration, const std::function<bool()>& should_stop,
                                        CorrectedRollout* corrected, const Rollout** rollout);
  // Adds to `stats` and to the `count` of minibatches. `start` gets the epoch's outputs; null: they are not wanted.
  absl::Status RunEpoch(const EpochKey& key, const Rollout& rollout, StartOutputs* start,
                        const std::function<bool()>& should_stop, UpdateStats* stats, int* count);
  // Sets normalised_advantages_.
  void NormaliseOverRollout(const Rollout& rollout);
  // RunEpochs, then distillation if there is one.
  absl::StatusOr<UpdateStats> RunIteration(int64_t iteration, const Rollout& rollout,
                                           const std::function<bool()>& should_stop);
  // Ends an iteration for the distiller, if there is one.
  void EndDistillation(int64_t iteration, bool succeeded);
  // One optimiser step. Adds its gradient norm and the means of its losses to `stats`, but returns that of approx_kl.
  absl::StatusOr<double> RunMinibatch(const Rollout& rollout, const Minibatch& minibatch, StartOutputs* start,
                                      UpdateStats* stats);
  ShardedMinibatch CutForShards(const Rollout& rollout, const Minibatch& minibatch, StartOutputs* start);
  void Restore(State state);
  // Restore(before), whose weights are in `shared_weights_`.
  void Undo(State before);
  // DataLoss: weights or value normaliser are not finite, or as GradientShards::TryWeights.
  absl::Status CheckWeights(const Rollout& rollout);

  const AgentSpec spec_;
  const v1::PpoConfig config_;
  const uint64_t seed_;
  const int gradient_shards_;
  const bool corrects_lag_;
  const bool distills_;
  WorkerPool workers_;
  State state_;                                          // the shards' nets look into the weights
  std::shared_ptr<const PolicyWeights> shared_weights_;  // those of state_; null: they have changed since
  std::unique_ptr<GradientShards> shards_;               // null: on a device
  std::unique_ptr<Distiller> distiller_;                 // null: no distillation
  std::optional<RankSums> ranks_;                        // unset: no other ranks
  std::vector<float> normalised_advantages_;             // of the running update, with advantages_over_rollout
  const std::unique_ptr<DeviceUpdate> device_;           // null: on the CPU
};

}  // namespace craftfleet
