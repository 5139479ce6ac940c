// Evaluations under way: what is to be played, who plays it, what came of it.

#ifndef CRAFTFLEET_LEARNER_EVALUATION_BOOK_H_
#define CRAFTFLEET_LEARNER_EVALUATION_BOOK_H_

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

#include "common/clock.h"
#include "common/mutex.h"
#include "common/types.h"

namespace craftfleet {

// Argmax episodes, then as many sampled ones, of the weights of one moment.
// Source: the protocol page, "Training protocol".
struct Evaluation {
  int64_t number = 0;                          // of the run, from 1
  int64_t env_steps = 0;                       // trained when the weights were made
  int64_t first_episode = 1;                   // of the evaluation environment
  int episodes = 0;                            // of each kind, 1..
  bool final = false;                          // after training
  std::shared_ptr<const std::string> weights;  // safetensors
};

struct FinishedEvaluation {
  Evaluation evaluation;
  std::vector<Episode> argmax;   // [episodes]
  std::vector<Episode> sampled;  // [episodes]
};

// An evaluation is two tasks, one for each kind of episode. A task is leased like a permit: an actor that has not
// spoken of it for `lease` loses it to the next that asks. So does one that has had it for two minutes, or for four
// times as long as the longest took if that is more, and for twice as long each time that it moves on: who merely
// speaks must not hold up a run. The one that had it may still answer, and the first counts. Thread-safe.
class EvaluationBook {
 public:
  struct Task {
    int64_t id = 0;  // from 1
    int64_t first_episode = 1;
    int episodes = 0;
    bool greedy = false;
  };

  // `clock` outlives the book.
  EvaluationBook(absl::Duration lease, Clock* clock) : lease_(lease), clock_(clock) {}

  // Numbers ascend from call to call.
  void Add(Evaluation evaluation) ABSL_LOCKS_EXCLUDED(mu_);

  // Renews `id`, which `actor` says that it plays (0: none); the other tasks that it had are free again.
  void Renew(absl::string_view actor, int64_t id) ABSL_LOCKS_EXCLUDED(mu_);
  // The oldest task that nobody plays, for `actor`, which has none.
  std::optional<Task> Take(absl::string_view actor) ABSL_LOCKS_EXCLUDED(mu_);
  // Whether `actor` has a task.
  bool IsPlaying(absl::string_view actor) const ABSL_LOCKS_EXCLUDED(mu_);
  // The weights to play task `id` with; nullptr: the task is over.
  std::shared_ptr<const std::string> Weights(int64_t id) const ABSL_LOCKS_EXCLUDED(mu_);
  // What came of task `id`. A task that is over is left as it is.
  //   InvalidArgument: not as many episodes as the task has.
  absl::Status Finish(int64_t id, absl::Span<const Episode> episodes) ABSL_LOCKS_EXCLUDED(mu_);

  // Waits up to `timeout` for the oldest evaluation to be over; it stays until Pop.
  std::optional<FinishedEvaluation> Front(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);
  void Pop() ABSL_LOCKS_EXCLUDED(mu_);
  // All that were added and not popped, oldest first.
  std::vector<Evaluation> Pending() const ABSL_LOCKS_EXCLUDED(mu_);
  size_t pending() const ABSL_LOCKS_EXCLUDED(mu_);  // their number

 private:
  struct Part {
    std::string actor;  // that plays it; empty: nobody
    absl::Time last_word;
    absl::Time begun;               // when the actor got it
    int moves = 0;                  // away from actors that still spoke
    std::vector<Episode> episodes;  // filled when it is over
  };
  struct Entry {
    Evaluation evaluation;
    std::array<Part, 2> parts;  // argmax, sampled
    bool finished() const { return !parts[0].episodes.empty() && !parts[1].episodes.empty(); }
  };

  static int64_t TaskId(const Evaluation& evaluation, size_t part) {
    return 2 * evaluation.number + static_cast<int64_t>(part);
  }
  // Of the entry that task `id` belongs to; entries_.size() if there is none.
  size_t IndexOf(int64_t id) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Whether `actor` may have it.
  bool IsFree(const Part& part, absl::string_view actor, absl::Time now) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool FrontFinished() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    return !entries_.empty() && entries_.front().finished();
  }

  const absl::Duration lease_;
  Clock* const clock_;
  mutable Mutex mu_;
  CondVar changed_;
  std::deque<Entry> entries_ ABSL_GUARDED_BY(mu_);
  absl::Duration longest_ ABSL_GUARDED_BY(mu_);  // that a task took
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_EVALUATION_BOOK_H_
