// One PPO iteration in numbers.

#pragma once

#include <optional>

namespace craftfleet {

// A phase of distillation in numbers: means over its optimiser steps. Source: distillation/DISTILLATION.md, section 5.
struct DistillationStats {
  double matching_loss = 0;    // of recognising equal achievements of different episodes; 0 without steps
  double prediction_loss = 0;  // of predicting the next achievement, likewise
  double divergence = 0;       // KL(policy || policy before the phase), nats, over all steps
  double value_loss = 0;       // mean squared error of normalised values, over all steps
  int matching_steps = 0;
  int prediction_steps = 0;
  int episodes = 0;  // whole ones with an achievement
};

// Of the rollout's importance weights: the probability of a step's action under the policy at its minibatch of the
// first epoch, divided by that under the policy which played. So they also show how far the first epoch moved the
// policy: without lag they are 1 in its first minibatch alone. Source: PPO.md, section 10.
struct ImportanceStats {
  double mean = 0;
  double min = 0;
  double max = 0;
};

// Means over the iteration's minibatches, unless stated otherwise. Formulas: learner/ppo/PPO.md, section 7.
struct UpdateStats {
  double policy_loss = 0;
  double value_loss = 0;          // mean squared error, of normalised values where values are
  double entropy = 0;             // nats
  double clip_fraction = 0;       // of rows whose probability ratio left 1 +- clip
  double gradient_norm = 0;       // L2, before clipping
  double approx_kl = 0;           // of the last epoch
  double explained_variance = 0;  // 1 - Var(returns - values) / Var(returns) of the rollout; 0 if returns are constant
  std::optional<ImportanceStats> importance;      // if the update uses them
  std::optional<DistillationStats> distillation;  // of iterations that end with a phase
};

}  // namespace craftfleet
