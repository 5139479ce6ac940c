// The gradient of a minibatch in parts ("shards"), each computed by one thread.

#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include <ATen/core/ATen_fwd.h>
#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "common/base/worker_pool.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/adam.h"
#include "learner/ppo/lag_correction.h"
#include "learner/ppo/minibatches.h"
#include "learner/ppo/ppo_loss.h"
#include "learner/ppo/rank_sums.h"
#include "learner/ppo/rollout.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

struct Dropout;
struct NetOutput;

// A minibatch, cut for the shards, with its targets.
struct ShardedMinibatch {
  std::vector<Minibatch> parts;   // at most one for each shard
  std::vector<size_t> firsts;     // [parts] the row of the minibatch that each begins with
  std::vector<float> advantages;  // [n] normalised
  std::vector<float> returns;     // [n] normalised where values are
  uint64_t dropout_key = 0;
  StartOutputs* start = nullptr;  // gets the outputs for this minibatch's rows, with `scale`; null: they are not wanted
  ValueScale scale = {};
};

// Replicas of the network, one for each shard. Owned by one thread, which computes as well. With ranks, each function
// computes this rank's shards and returns what all ranks have; errors then also as those of RankGroup.
class GradientShards {
 public:
  // `count` shards on the CPU, whose networks look into `weights`, [param_count]. Spec, configuration, weights and
  // workers outlive this.
  GradientShards(const AgentSpec& spec, const v1::PpoConfig& config, int count, absl::Span<float> weights,
                 WorkerPool* workers);
  ~GradientShards();

  // From now on the ranks share out the shards; `ranks` outlives this.
  void ShareOut(RankSums* ranks);

  // The sums of the losses over the minibatch's rows. `gradients` gets the gradients that AdamStep adds, valid until
  // the next call.
  //   Internal: LibTorch failed.   Cancelled: rank 0 was asked to stop.
  absl::StatusOr<PpoLossSums> ComputeGradients(const Rollout& rollout, const ShardedMinibatch& minibatch,
                                               std::vector<ShardGradient>* gradients);

  // Whether the weights can be played with, tried on some of the rollout's steps: the learner `accepts` these outputs
  // of the value head. The same on each rank.
  //   DataLoss: as CheckOutputs (divergence.h). LibTorch's exceptions pass.
  absl::Status TryWeights(const Rollout& rollout, const ValueRange& accepts);

 private:
  struct Shard;  // one replica: net, gradients, input

  // What all shards need of the present weights.
  absl::Status PrepareWeights();
  // Those that compute a minibatch's `parts` on this rank.
  ShardRange OwnShards(size_t parts) const;
  // The network's output for `part`, on the shard's frames.
  NetOutput Forward(const Rollout& rollout, const Minibatch& part, const std::optional<Dropout>& dropout,
                    Shard* shard) const;
  // Writes `output` of `part` to `start`.
  static void WriteStart(const Rollout& rollout, const Minibatch& part, const NetOutput& output,
                         const ValueScale& scale, StartOutputs* start);
  // Multiplies what the shards of `range` have left of wide layers' gradients: each sum goes into the first of
  // `gradients`, in several pieces.
  absl::Status SumWideGradients(ShardRange range, std::vector<ShardGradient>* gradients);
  // Forward and backward of the part with this number.
  void ComputeGradient(const Rollout& rollout, const ShardedMinibatch& minibatch, size_t number);

  const AgentSpec& spec_;
  const v1::PpoConfig& config_;
  const std::vector<uint8_t> no_frame_;  // [frame_bytes] zeros, for padding
  WorkerPool* const workers_;
  std::vector<std::unique_ptr<Shard>> shards_;
  std::vector<at::Tensor> wide_gradients_;  // of the last minibatch, in pieces
  RankSums* ranks_ = nullptr;               // null: no other ranks
};

}  // namespace craftfleet
