// Assigns the tasks of pending evaluations to actors, and collects their results.

#ifndef CRAFTFLEET_LEARNER_EVALUATION_SCHEDULER_H_
#define CRAFTFLEET_LEARNER_EVALUATION_SCHEDULER_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>
#include <absl/types/span.h>

#include "common/base/clock.h"
#include "common/base/types.h"

namespace craftfleet {

// Argmax episodes, then as many sampled ones, played with the same weights.
// Source: FORMATS.md, section 4.
struct Evaluation {
  int64_t number = 0;                          // of the run, from 1
  int64_t env_steps = 0;                       // environment steps trained when the weights were made
  int64_t first_episode = 1;                   // its number in the evaluation environment
  int episodes = 0;                            // of each kind, 1..kMaxEvaluationEpisodes
  bool final = false;                          // the evaluation after training
  std::shared_ptr<const std::string> weights;  // safetensors
};

struct FinishedEvaluation {
  Evaluation evaluation;
  std::vector<Episode> argmax;   // [episodes]
  std::vector<Episode> sampled;  // [episodes]
};

// Decides which actor plays which evaluation task. Has no lock: WorkerRegistry calls it under its mutex.
//
// An evaluation consists of two tasks, one for each kind of episode. A task is leased like a permit: if its actor has
// not reported it for its lease, the next actor that requests work gets it. So that an actor which only reports cannot
// hold up a run, the task is also given to another actor after two minutes, or after four times the median of the times
// that the last tasks have taken if that is more; this limit doubles each time. The first actor may still send its
// result, and the first result counts.
//
// Not thread-safe.
class EvaluationScheduler {
 public:
  struct Task {
    int64_t id = 0;  // from 1
    int64_t first_episode = 1;
    int episodes = 0;
    bool greedy = false;
  };

  // `clock` outlives the scheduler.
  explicit EvaluationScheduler(Clock* clock) : clock_(clock) {}

  // Adds an evaluation. Its number is higher than those added before.
  void Add(Evaluation evaluation);

  // Task `id`, which `actor` reports to be playing (0: none), has a `lease` from now on; frees the actor's other tasks.
  void Renew(absl::string_view actor, int64_t id, absl::Duration lease);
  // Assigns the oldest free task to `actor`, which has none, for a `lease`. Nothing: no task is free.
  std::optional<Task> Take(absl::string_view actor, absl::Duration lease);
  // Whether `actor` has a task.
  bool IsPlaying(absl::string_view actor) const;
  // The weights (safetensors) to play task `id` with; nullptr: the task is over.
  std::shared_ptr<const std::string> Weights(int64_t id) const;
  // Stores the result of task `id`; ignored if the task is over.
  //   InvalidArgument: the number of episodes differs from the task's.
  absl::Status Finish(int64_t id, absl::Span<const Episode> episodes);

  // Whether the oldest evaluation is finished.
  bool FrontFinished() const { return !entries_.empty() && entries_.front().finished(); }
  // The oldest evaluation if it is finished, else nothing.
  std::optional<FinishedEvaluation> Front() const;
  void Pop() { entries_.pop_front(); }
  // The evaluations added and not popped, oldest first.
  std::vector<Evaluation> Pending() const;
  size_t pending() const { return entries_.size(); }  // their number

 private:
  struct Part {
    std::string actor;  // plays it; empty: none
    absl::Time lease_end;
    absl::Time begun;               // when it was assigned to the actor
    int moves = 0;                  // reassignments although the actor still reported it
    std::vector<Episode> episodes;  // the result; empty until it is over
  };
  struct Entry {
    Evaluation evaluation;
    std::array<Part, 2> parts;  // argmax, sampled
    bool finished() const { return !parts[0].episodes.empty() && !parts[1].episodes.empty(); }
  };

  static int64_t TaskId(const Evaluation& evaluation, size_t part) {
    return 2 * evaluation.number + static_cast<int64_t>(part);
  }
  // The index in entries_ of the evaluation with task `id`; entries_.size() if not found.
  size_t IndexOf(int64_t id) const;
  // How long a task that moves for the first time must have been with its actor. A median, so that a few actors that
  // dawdle over their results do not stretch it.
  absl::Duration Patience() const;
  // Whether `part` may be assigned to `actor` at `now`.
  bool IsFree(const Part& part, absl::string_view actor, absl::Time now) const;

  Clock* const clock_;
  std::deque<Entry> entries_;
  std::deque<absl::Duration> times_;  // that the last tasks have taken, at most kMaxTimes
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_EVALUATION_SCHEDULER_H_
