// The optimiser steps of a phase of distillation, with their random choices already made.

#ifndef CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_STEPS_H_
#define CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_STEPS_H_

#include <functional>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/distillation/distillation_net.h"
#include "learner/ppo/distillation/kept_rollouts.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// Some steps of an episode, each with another step of it that serves as its negative.
struct PredictionBatch {
  const KeptEpisode* episode = nullptr;
  std::vector<int> steps;      // of the episode
  std::vector<int> negatives;  // [steps] likewise
};

// A goal of the source episode, by step, and the changes of features at two goals of another episode.
struct MatchedGoal {
  int source = 0;
  absl::Span<const float> positive;  // [F], as of GoalChanges under the present weights
  absl::Span<const float> negative;
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

// Makes the minibatches and losses of a phase. Owned by one thread. Source: DISTILLATION.md, sections 2 to 4.
class DistillationSteps {
 public:
  // The fields of `config` that count: ppo (value normaliser) and distillation. All pointers outlive the object.
  DistillationSteps(const AgentSpec& spec, const v1::RunConfig& config, const KeptRollouts* rollouts,
                    DistillationNet* net);

  // float[rows,17] logits of rows of the rollouts, without gradients.   Errors as DistillationNet.
  absl::StatusOr<std::vector<float>> Logits(absl::Span<const int> rows) { return net_->Logits(rows); }

  // For each episode, float[goals,F]: the change of features at each of its goals, under the present weights.
  absl::StatusOr<std::vector<std::vector<float>>> GoalChanges(absl::Span<const KeptEpisode* const> episodes);

  // One optimiser step that teaches to predict the next goal, or to recognise goals that are the same. `old_logits`,
  // float[n,17] for all rows of the rollouts, are those of the policy to keep.
  //   DataLoss: the gradient is not finite.   Others as DistillationNet.
  absl::StatusOr<DistillationLosses> Predict(const PredictionBatch& batch, const std::vector<float>& old_logits,
                                             ValueNorm* value_norm);
  absl::StatusOr<DistillationLosses> Match(const MatchingBatch& batch, const std::vector<float>& old_logits,
                                           ValueNorm* value_norm);

  // Of the agent's features (F).
  int code_size() const { return code_size_; }

 private:
  struct Step {
    std::vector<int> rows;    // distinct, of the rollouts
    std::vector<int> counts;  // how often each counts in keeping policy and value
    DistillationLoss loss = DistillationLoss::kMatching;
  };
  // The contrastive loss of `outputs`; adds its gradients.
  using Contrast = std::function<double(const NetNumbers& outputs, NetNumbers* gradients)>;

  absl::StatusOr<DistillationLosses> Run(const Step& step, const Contrast& contrast,
                                         const std::vector<float>& old_logits, ValueNorm* value_norm);
  // Adds the losses that keep policy and value, and their gradients.
  void KeepPolicyAndValue(const Step& step, const NetNumbers& outputs, const std::vector<float>& old_logits,
                          ValueNorm* value_norm, NetNumbers* gradients, DistillationLosses* losses) const;

  const v1::PpoConfig ppo_;
  const double temperature_;
  const int code_size_;
  const KeptRollouts* const rollouts_;
  DistillationNet* const net_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_PPO_DISTILLATION_DISTILLATION_STEPS_H_
