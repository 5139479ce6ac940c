// The optimiser steps of a phase of distillation, with their random choices already made.

#ifndef CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_STEPS_H_
#define CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_STEPS_H_

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "common/base/worker_pool.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/adam.h"
#include "learner/ppo/distillation/kept_rollouts.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// Some steps of an episode, each with another step of it that serves as its negative.
struct PredictionBatch {
  const KeptEpisode* episode = nullptr;
  std::vector<int> steps;      // of the episode
  std::vector<int> negatives;  // [steps] likewise
};

// A goal of the source episode, and two of the same other episode, by step.
struct MatchedGoal {
  int source = 0;
  const KeptEpisode* target = nullptr;
  int positive = 0;
  int negative = 0;
};
struct MatchingBatch {
  const KeptEpisode* source = nullptr;
  std::vector<MatchedGoal> goals;  // at least one
  std::vector<int> kept;           // steps of the source at which policy and value are kept, with repetition
};

// The losses of one step, means over its rows.
struct DistillationLosses {
  double contrastive = 0;
  double divergence = 0;     // KL(new policy || old one), nats
  double value = 0;          // squared error of normalised values
  double gradient_norm = 0;  // L2, before clipping
};

// Computes on the weights of an update. Minibatches are cut into `gradient_shards` parts, as in PpoUpdater: the number
// of threads changes no bit. Owned by one thread. Source: DISTILLATION.md, sections 2 to 4.
class DistillationSteps {
 public:
  // The fields of `config` that count: ppo (optimiser, value normaliser), distillation and gradient_shards. `weights`,
  // float[spec.param_count], and all pointers outlive the object.
  DistillationSteps(const AgentSpec& spec, const v1::RunConfig& config, const KeptRollouts* rollouts,
                    absl::Span<float> weights, WorkerPool* workers);
  ~DistillationSteps();

  // float[rows,F] features and float[rows,17] logits of rows of the rollouts, without gradients.
  //   Internal: LibTorch failed.
  absl::StatusOr<std::vector<float>> Codes(absl::Span<const int> rows);
  absl::StatusOr<std::vector<float>> Logits(absl::Span<const int> rows);

  // float[goals,F]: the change of features at each goal of `episode`, under the present weights; [F] each.
  absl::StatusOr<std::vector<float>> GoalChanges(const KeptEpisode& episode);

  // One step of `adam` that teaches to predict the next goal, or to recognise goals that are the same. `old_logits`,
  // float[n,17] for all rows of the rollouts, are those of the policy to keep.
  //   DataLoss: the gradient is not finite.   Internal: LibTorch failed.
  absl::StatusOr<DistillationLosses> Predict(const PredictionBatch& batch, const std::vector<float>& old_logits,
                                             ValueNorm* value_norm, AdamState* adam);
  absl::StatusOr<DistillationLosses> Match(const MatchingBatch& batch, const std::vector<float>& old_logits,
                                           ValueNorm* value_norm, AdamState* adam);

  // Of the agent's features (F).
  int code_size() const { return code_size_; }

 private:
  struct Shard;    // one replica: net, input, output
  struct Numbers;  // of the rows of a step: outputs, or gradients by them
  struct Step {
    std::vector<int> rows;    // distinct, of the rollouts
    std::vector<int> counts;  // how often each counts in keeping policy and value
    bool predicts = false;    // needs predictions
  };
  // The contrastive loss of `outputs`; adds its gradients.
  using Contrast = std::function<double(const Numbers& outputs, Numbers* gradients)>;

  absl::StatusOr<DistillationLosses> Run(const Step& step, const Contrast& contrast,
                                         const std::vector<float>& old_logits, ValueNorm* value_norm, AdamState* adam);
  // Adds the losses that keep policy and value, and their gradients.
  void KeepPolicyAndValue(const Step& step, const Numbers& outputs, const std::vector<float>& old_logits,
                          ValueNorm* value_norm, Numbers* gradients, DistillationLosses* losses) const;
  // Runs `part(shard, first, count)` for the parts of `rows` rows.
  absl::Status RunShards(size_t rows, const std::function<void(Shard*, size_t, size_t)>& part);
  absl::StatusOr<Numbers> Forward(const Step& step);
  absl::Status Backward(const Numbers& gradients, size_t rows);
  // The frames of `rows`, as input of the shard's net.
  void LoadFrames(absl::Span<const int> rows, Shard* shard) const;

  const AgentSpec spec_;
  const v1::PpoConfig ppo_;
  const double temperature_;
  const int code_size_;
  const KeptRollouts* const rollouts_;
  const absl::Span<float> weights_;
  WorkerPool* const workers_;
  std::vector<std::unique_ptr<Shard>> shards_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_STEPS_H_
