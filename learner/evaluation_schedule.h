// When a run's weights are evaluated, and where the results go.

#ifndef CRAFTFLEET_LEARNER_EVALUATION_SCHEDULE_H_
#define CRAFTFLEET_LEARNER_EVALUATION_SCHEDULE_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include <absl/time/time.h>

#include "craftfleet/v1/checkpoint.pb.h"
#include "craftfleet/v1/config.pb.h"
#include "learner/evaluation_book.h"
#include "learner/run/checkpoint.h"
#include "learner/run/run_folder.h"

namespace craftfleet {

// The trainer's side of evaluation: begins one whenever training passes a multiple of `eval.every_steps`, and one after
// it; logs them in their order, whenever they come back. Actors play them beside training, which waits only if
// kMaxPending are under way. Owned by one thread.
// Source: the protocol page, "Training protocol".
class EvaluationSchedule {
 public:
  static constexpr size_t kMaxPending = 2;

  // Begins after `checkpoint`; what was under way there is to be played again. `book` and `folder` outlive this.
  EvaluationSchedule(const v1::EvalConfig& config, const Checkpoint& checkpoint, EvaluationBook* book,
                     RunFolder* folder);

  // Training went from `steps_before` to `env_steps` and has `weights` (safetensors) now. Writes what is over.
  // `should_stop` ends the wait for evaluators.
  void OnIteration(int64_t steps_before, int64_t env_steps, const std::shared_ptr<const std::string>& weights,
                   const std::function<bool()>& should_stop);

  // Training is over: evaluates `weights` unless that was done at `env_steps` before, then waits until every result is
  // in the logs.
  void OnEnd(int64_t env_steps, const std::shared_ptr<const std::string>& weights,
             const std::function<bool()>& should_stop);

  // Where a later start is to go on.
  void FillCheckpoint(Checkpoint* checkpoint) const;

 private:
  void Begin(int64_t env_steps, int episodes, bool final, const std::shared_ptr<const std::string>& weights);
  // Logs finished evaluations until fewer than `below` are pending; waits for that unless should_stop().
  void LogFinished(size_t below, const std::function<bool()>& should_stop);
  bool LogFront(absl::Duration timeout);

  const v1::EvalConfig config_;
  EvaluationBook* const book_;
  RunFolder* const folder_;
  int64_t begun_;                   // evaluations
  int64_t next_episode_;            // of the evaluation environment
  int64_t final_evaluation_steps_;  // env_steps of the last final evaluation; 0: none
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_EVALUATION_SCHEDULE_H_
