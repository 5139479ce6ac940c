// Distillation's network on the CPU.

#pragma once

#include <functional>
#include <memory>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "common/base/worker_pool.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/adam.h"
#include "learner/ppo/distillation/distillation_net.h"
#include "learner/ppo/update_state.h"

namespace craftfleet {

// Cuts rows into `gradient_shards` parts, as PpoUpdater does: the number of threads changes no bit.
class ShardedNet final : public DistillationNet {
 public:
  // The fields of `config` that count: ppo (the optimiser's) and gradient_shards. `weights`, float[spec.param_count],
  // `adams` and `workers` outlive the object.
  ShardedNet(const AgentSpec& spec, const v1::RunConfig& config, absl::Span<float> weights, DistillationAdams* adams,
             WorkerPool* workers);
  ~ShardedNet() override;

  absl::Status Begin(const KeptRollouts* rollouts) override;
  void End() override { rollouts_ = nullptr; }
  absl::StatusOr<std::vector<float>> Logits(absl::Span<const int> rows) override;
  absl::Status SetOldLogits(std::vector<float> logits) override;
  absl::StatusOr<std::vector<float>> Changes(absl::Span<const FramePair> pairs) override;
  absl::Status Step(const DistillationStep& step) override;
  absl::StatusOr<DistillationLosses> TakeLosses(DistillationLoss loss) override;

 private:
  struct Shard;  // one replica: net, input, output

  // Runs `part(shard, first, count)` for the parts of `rows` rows.
  absl::Status RunShards(size_t rows, const std::function<void(Shard*, size_t, size_t)>& part);
  // float[rows,F] features, without gradients.
  absl::StatusOr<std::vector<float>> Codes(absl::Span<const int> rows);
  absl::StatusOr<NetNumbers> Forward(absl::Span<const int> rows, bool predicts);
  absl::Status Backward(const NetNumbers& gradients);
  // Returns the L2 norm of the weights' gradient after Backward, before clipping.
  double StepAdam(size_t rows, AdamState* adam);
  DistillationLosses* SumsOf(DistillationLoss loss) {
    return loss == DistillationLoss::kMatching ? &matching_sums_ : &prediction_sums_;
  }
  // The frames of `rows`, as input of the shard's net.
  void LoadFrames(absl::Span<const int> rows, Shard* shard) const;

  const AgentSpec spec_;
  const v1::PpoConfig ppo_;
  const absl::Span<float> weights_;
  DistillationAdams* const adams_;
  WorkerPool* const workers_;
  std::vector<std::unique_ptr<Shard>> shards_;

  const KeptRollouts* rollouts_ = nullptr;  // between Begin and End
  std::vector<float> old_logits_;           // float[n,17] of all rows
  std::vector<float> changes_;              // float[pairs,F] that Changes computed last
  DistillationLosses matching_sums_;
  DistillationLosses prediction_sums_;
};

}  // namespace craftfleet
