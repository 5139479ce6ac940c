// Plans a run's evaluations: when, on which episodes, and in which order results are logged.

#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include <absl/time/time.h>

#include "craftfleet/v1/checkpoint.pb.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/run/checkpoint.h"
#include "learner/run/run_folder.h"
#include "learner/scheduling/worker_registry.h"

namespace craftfleet {

// The trainer's side of evaluation. Begins one whenever training passes a multiple of `eval.every_steps`, and a final
// one after training. Each plays `episodes` argmax episodes, then as many sampled ones; the evaluation environment's
// episodes are numbered from 1 and continue from evaluation to evaluation. A final evaluation plays the next numbers
// but does not advance them, so that an extended run continues as if it had not ended before. Results are logged in the
// order in which evaluations began. Actors play while training continues; training waits only if more than
// kMaxPending evaluations are pending. Owned by one thread.
class EvaluationPlanner {
 public:
  static constexpr size_t kMaxPending = 2;

  // Continues after `checkpoint`, in a run that ends after `steps`. The checkpoint's pending evaluations are played
  // again, except for a pending final evaluation if training continues, since its weights are no longer the final ones.
  // `registry` and `folder` outlive this.
  EvaluationPlanner(const v1::EvalConfig& config, int64_t steps, const Checkpoint& checkpoint, WorkerRegistry* registry,
                    RunFolder* folder);

  // To be called before training goes on: waits, like OnIteration, if earlier starts have left too many pending.
  void OnStart(const std::function<bool()>& should_stop);

  // To be called when training has advanced from `steps_before` to `env_steps` environment steps; `weights`
  // are the new ones. Logs finished evaluations. `should_stop` ends the wait for actors, in which it is
  // called several times a second; FillCheckpoint may be called from it.
  void OnIteration(int64_t steps_before, int64_t env_steps, const std::shared_ptr<const PolicyWeights>& weights,
                   const std::function<bool()>& should_stop);

  // To be called when training is over: evaluates `weights`, unless an earlier start did so at `env_steps`, then waits
  // until every result is logged or should_stop() is true.
  void OnEnd(int64_t env_steps, const std::shared_ptr<const PolicyWeights>& weights,
             const std::function<bool()>& should_stop);

  // The number of evaluations that have begun and are not logged.
  size_t pending() const { return registry_->evaluations()->pending(); }

  // Adds the state that a later start needs to continue. Errors as PolicyWeights::Bytes.
  absl::Status FillCheckpoint(Checkpoint* checkpoint) const;

 private:
  void Begin(int64_t env_steps, int episodes, bool final, const std::shared_ptr<const PolicyWeights>& weights);
  // Logs finished evaluations until fewer than `below` are pending; waits for that unless should_stop().
  void LogFinished(size_t below, const std::function<bool()>& should_stop);
  // Logs the oldest evaluation if it is finished within `timeout`.
  bool LogOldest(absl::Duration timeout);

  const v1::EvalConfig config_;
  WorkerRegistry* const registry_;
  RunFolder* const folder_;
  int64_t begun_;                   // number of evaluations begun
  int64_t next_episode_;            // next episode of the evaluation environment
  int64_t final_evaluation_steps_;  // env_steps of the last final evaluation; 0: none
};

}  // namespace craftfleet
