// The optimiser steps of a phase of distillation, with their random choices already made.

#pragma once

#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/types/span.h>

#include "common/agent/agent_spec.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/distillation/distillation_net.h"
#include "learner/ppo/distillation/kept_rollouts.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// Some steps of an episode, each with a step of it, drawn by a permutation, that serves as its negative.
struct PredictionBatch {
  const KeptEpisode* episode = nullptr;
  std::vector<int> steps;      // of the episode
  std::vector<int> negatives;  // [steps] likewise
};

// The changes of features at the goals of some episodes.
struct GoalChanges {
  std::vector<float> values;  // [goals,F] of length 1 or 0, episode by episode
  std::vector<int> first;     // by episode, its first goal; then the number of goals
};

// A goal of the source episode, by step, and two of another one, by their numbers in the last GoalChanges.
struct MatchedGoal {
  int source = 0;
  int positive = 0;
  int negative = 0;
};
struct MatchingBatch {
  const KeptEpisode* source = nullptr;
  std::vector<MatchedGoal> goals;  // at least one
  std::vector<int> kept;           // steps of the source at which policy and value are kept, with repetition
};

// Makes the steps of a phase, which `net` takes. Owned by one thread. Errors are those of DistillationNet.
// Source: DISTILLATION.md, sections 2 to 4.
class DistillationSteps {
 public:
  // The fields of `config` that count: ppo (value normaliser) and distillation. All pointers outlive the object.
  DistillationSteps(const AgentSpec& spec, const v1::RunConfig& config, const KeptRollouts* rollouts,
                    DistillationNet* net);

  // Keeps the policy as it is now, at all steps of `episodes`.
  absl::Status KeepPolicy(absl::Span<const KeptEpisode> episodes);

  // The changes at the goals of `episodes`, at least one, under the present weights.
  absl::StatusOr<GoalChanges> ChangesAtGoals(absl::Span<const KeptEpisode* const> episodes);

  // One optimiser step that teaches to predict the next goal, or to recognise goals that are the same.
  absl::Status Predict(const PredictionBatch& batch, ValueNorm* value_norm);
  absl::Status Match(const MatchingBatch& batch, ValueNorm* value_norm);

  // Of the agent's features (F).
  int code_size() const { return code_size_; }

 private:
  // Takes a step that has its rows and contrasts. Row i of it counts `counts[i]` times in keeping policy and value.
  absl::Status Run(DistillationStep step, const std::vector<int>& counts, ValueNorm* value_norm);

  const v1::PpoConfig ppo_;
  const double temperature_;
  const int code_size_;
  const KeptRollouts* const rollouts_;
  DistillationNet* const net_;
};

}  // namespace craftfleet
