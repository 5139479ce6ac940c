// Achievement distillation (Moon et al. 2023): every few iterations, trains the features on the achievements of the
// episodes since the last time. Equations: DISTILLATION.md.

#pragma once

#include <cstdint>
#include <functional>
#include <memory>

#include <absl/status/status.h>

#include "common/agent/agent_spec.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/ppo/distillation/distillation_net.h"
#include "learner/ppo/distillation/distillation_steps.h"
#include "learner/ppo/distillation/kept_rollouts.h"
#include "learner/ppo/update_stats.h"
#include "learner/ppo/value_norm.h"

namespace craftfleet {

// Keeps rollouts and runs the phases. Owned by one thread.
class Distiller {
 public:
  // The fields of `config` that count: seed, lanes, ppo and distillation. `net` computes on the weights that PPO
  // trains.
  Distiller(const AgentSpec& spec, const v1::RunConfig& config, std::unique_ptr<DistillationNet> net);

  // Whether a phase follows PPO's epochs of `iteration`, from 0.
  bool IsDue(int64_t iteration) const { return (iteration + 1) % config_.every_iterations() == 0; }

  // To be called after PPO's epochs of `iteration` with its rollout, which is copied: runs the phase if it is due.
  // `should_stop` is asked after each optimiser step.
  //   Cancelled: should_stop() said so.   Others as DistillationSteps. The caller then restores weights, Adams and
  //   normaliser and calls Undo.
  absl::Status OnIteration(int64_t iteration, const Rollout& rollout, const std::function<bool()>& should_stop,
                           ValueNorm* value_norm, UpdateStats* stats);
  // Ends OnIteration: as if `iteration` had not been played, or for good.
  void Undo(int64_t iteration) { rollouts_.DropFrom(iteration); }
  void Commit(int64_t iteration);

  // What a later start needs besides weights, Adams and normaliser: the kept rollouts.
  void Save(SafeTensors* file) const { rollouts_.Save(file); }
  absl::Status Load(const SafeTensors& file) { return rollouts_.Load(file); }

 private:
  class Phase;

  const v1::DistillationConfig config_;
  const uint64_t seed_;
  KeptRollouts rollouts_;
  const std::unique_ptr<DistillationNet> net_;
  DistillationSteps steps_;
};

}  // namespace craftfleet
