// Assigns the tasks of pending evaluations to actors, and collects their results.

#pragma once

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

#include "common/agent/policy_weights.h"
#include "common/base/clock.h"
#include "common/base/types.h"
#include "learner/scheduling/overdue.h"

namespace craftfleet {

// Argmax episodes, then as many sampled ones, played with the same weights.
// Source: FORMATS.md, section 4.
struct Evaluation {
  int64_t number = 0;         // of the run, from 1
  int64_t env_steps = 0;      // environment steps trained when the weights were made
  int64_t first_episode = 1;  // its number in the evaluation environment
  int episodes = 0;           // of each kind, 1..kMaxEvaluationEpisodes
  bool final = false;         // the evaluation after training
  std::shared_ptr<const PolicyWeights> weights;
};

struct FinishedEvaluation {
  Evaluation evaluation;
  std::vector<Episode> argmax;   // [episodes]
  std::vector<Episode> sampled;  // [episodes]
};

// Decides which actor plays which evaluation task. Has no lock: WorkerRegistry calls it under its mutex.
//
// An evaluation consists of two tasks, one for each kind of episode. A task is leased like a permit: if none of its
// players has reported it for its lease, the next actor that requests work gets it. An overdue one (Overdue) is given
// to one more actor, whatever its players report: at first only to one of another client, after `kPatience` to any. An
// actor that is late with its fragments comes last, after `kPatienceWithLate`. The first result of an actor that got
// the task counts.
//
// Not thread-safe.
class EvaluationTable {
 public:
  static constexpr absl::Duration kLeast = absl::Seconds(30);    // no task is overdue earlier,
  static constexpr absl::Duration kAtFirst = absl::Minutes(2);   // or this early if there are no results yet
  static constexpr absl::Duration kPatience = absl::Seconds(2);  // longer than the time between two requests
  static constexpr absl::Duration kPatienceWithLate = absl::Seconds(10);

  struct Task {
    int64_t id = 0;  // from 1
    int64_t first_episode = 1;
    int episodes = 0;
    bool greedy = false;
  };

  // `clock` outlives the table.
  explicit EvaluationTable(Clock* clock) : clock_(clock) {}

  // Adds an evaluation. Its number is higher than those added before.
  void Add(Evaluation evaluation);

  // Task `id`, which `actor` reports to be playing (0: none), has a `lease` from now on; frees the actor's other tasks.
  void Renew(absl::string_view actor, int64_t id, absl::Duration lease);
  // Assigns the oldest task that is free or overdue to `actor` of `client` (WorkerClient::Name), which has none, for a
  // `lease`. `is_late`: with its fragments. Nothing: there is none.
  std::optional<Task> Take(absl::string_view actor, absl::Duration lease, absl::string_view client = "",
                           bool is_late = false);
  // Whether `actor` has a task.
  bool IsPlaying(absl::string_view actor) const;
  // The weights to play task `id` with; nullptr: the task is over.
  std::shared_ptr<const PolicyWeights> Weights(int64_t id) const;
  // Stores the result of task `id`; ignored if the evaluation is over.
  //   InvalidArgument: the number of episodes differs from the task's; or the task is over, with another result: names
  //   both actors.   FailedPrecondition: `actor` does not have the task.
  absl::Status Finish(absl::string_view actor, int64_t id, absl::Span<const Episode> episodes);
  // The unfinished tasks that are being played, and by whom: "evaluation task 4 (actor a for 3m5s)".
  std::vector<std::string> BeingPlayed() const;

  // Whether the oldest evaluation is finished.
  bool FrontFinished() const { return !entries_.empty() && entries_.front().finished(); }
  // The oldest evaluation if it is finished, else nothing.
  std::optional<FinishedEvaluation> Front() const;
  void Pop() { entries_.pop_front(); }
  // The evaluations added and not popped, oldest first.
  std::vector<Evaluation> Pending() const;
  size_t pending() const { return entries_.size(); }  // their number

 private:
  struct Player {
    std::string actor;
    std::string client;
    absl::Time since;      // when it got the task
    absl::Time lease_end;  // it may send its result even later
  };
  struct Part {
    absl::Time since;               // when it was added, or last assigned
    std::vector<Player> players;    // in the order in which they got it
    std::vector<Episode> episodes;  // the result; empty until it is over
    std::string sender;             // of the result
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
  static Player* FindPlayer(absl::string_view actor, Part* part);
  // Whether `part` may be assigned at `now`; the others as for Take.
  bool IsFree(const Part& part, absl::string_view actor, absl::string_view client, bool is_late, absl::Time now) const;

  Clock* const clock_;
  std::deque<Entry> entries_;
  Overdue overdue_{kLeast, kAtFirst};
};

}  // namespace craftfleet
