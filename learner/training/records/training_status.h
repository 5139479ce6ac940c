// Training's part of status replies.

#ifndef CRAFTFLEET_LEARNER_TRAINING_RECORDS_TRAINING_STATUS_H_
#define CRAFTFLEET_LEARNER_TRAINING_RECORDS_TRAINING_STATUS_H_

#include <atomic>
#include <cstdint>

#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/telemetry/activity_meter.h"
#include "craftfleet/v1/config.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/run/score.h"
#include "learner/training/staleness.h"

namespace craftfleet {

// Progress of training. Written by the training thread, read by any.
struct TrainerCounters {
  std::atomic<int64_t> iteration{0};        // finished iterations
  std::atomic<int64_t> env_steps{0};        // accepted, over all starts of the run
  std::atomic<int64_t> start_steps{0};      // env_steps at the beginning of this start
  std::atomic<int64_t> policy_version{-1};  // of the weights last published
};

// Fed by the training thread at each iteration; Fill is thread-safe.
class TrainingStatus {
 public:
  // `config`, `counters` and `clock` outlive this.
  TrainingStatus(const v1::RunConfig& config, const TrainerCounters* counters, Clock* clock);

  // Shows `score`, that of earlier starts, until the first iteration ends.
  void OnStart(const ScoreBoard& score) ABSL_LOCKS_EXCLUDED(mu_);
  void OnIterationBegin() ABSL_LOCKS_EXCLUDED(mu_);
  // The current iteration is finished; `score` includes its episodes.
  void OnIterationEnd(const ScoreBoard& score) ABSL_LOCKS_EXCLUDED(mu_);
  // An update with fragments this old is finished.
  void OnUpdate(const Staleness& staleness) ABSL_LOCKS_EXCLUDED(mu_);
  // The current iteration's update failed and was undone.
  void OnUpdateUndone() { ++undone_; }

  // Adds summary and metrics. `meter` is the training thread's; `checkpoint_age` is CheckpointWriter::age().
  void Fill(const ActivityMeter& meter, absl::Duration checkpoint_age, v1::StatusReply* reply) const
      ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // As of the last finished iteration.
  struct Shown {
    int64_t episodes = 0;
    double reward = 0;  // means of the last 100 episodes
    double length = 0;
    double score = 0;
    int unlocked = 0;
  };
  static Shown ShownOf(const ScoreBoard& score);

  const v1::RunConfig& config_;
  const TrainerCounters* const counters_;
  Clock* const clock_;
  std::atomic<int64_t> undone_{0};  // updates undone since the start

  mutable Mutex mu_;
  Shown shown_ ABSL_GUARDED_BY(mu_);
  Staleness staleness_ ABSL_GUARDED_BY(mu_);            // of the last update
  absl::Duration iteration_time_ ABSL_GUARDED_BY(mu_);  // of the last iteration; 0: none has ended since the start
  absl::Time iteration_begin_ ABSL_GUARDED_BY(mu_) = absl::InfiniteFuture();  // start of the current iteration
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_TRAINING_RECORDS_TRAINING_STATUS_H_
