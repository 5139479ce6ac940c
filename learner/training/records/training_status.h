// What status replies and the live page show of training.

#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "common/base/types.h"
#include "common/telemetry/activity_meter.h"
#include "craftfleet/v1/config.pb.h"
#include "craftfleet/v1/status.pb.h"
#include "learner/run/run_folder.h"
#include "learner/run/score_curve.h"
#include "learner/training/staleness.h"

namespace craftfleet {

// Progress of training. Written by the training thread, read by any.
struct TrainerCounters {
  std::atomic<int64_t> iteration{0};        // finished iterations
  std::atomic<int64_t> env_steps{0};        // accepted, over all starts of the run
  std::atomic<int64_t> start_steps{0};      // env_steps at the beginning of this start
  std::atomic<int64_t> policy_version{-1};  // of the weights last published
};

// Fed by the training thread at each iteration; Fill and view are thread-safe.
class TrainingStatus {
 public:
  struct SpeedPoint {
    int64_t env_steps = 0;        // accepted, over all starts of the run
    double steps_per_second = 0;  // of the iteration that ended there
  };
  // As of the end of an iteration.
  struct View {
    int64_t number = 0;  // differs from that of every other view of this process
    int64_t env_steps = 0;
    ScoreBoard score;
    std::vector<CurvePoint> curve;
    std::vector<SpeedPoint> speed;  // since this start
    int frame_size = 0;             // pixels
    std::string frame;              // what an agent saw at the end, uint8[frame_size,frame_size,3]; empty: none yet
  };

  // `config`, `counters` and `clock` outlive this.
  TrainingStatus(const v1::RunConfig& config, const TrainerCounters* counters, Clock* clock)
      : config_(config), counters_(counters), clock_(clock) {}

  // Shows `folder`'s score and curve of earlier starts until the first iteration ends.
  void OnStart(const RunFolder& folder) ABSL_LOCKS_EXCLUDED(mu_);
  void OnIterationBegin() ABSL_LOCKS_EXCLUDED(mu_);
  // The current iteration is finished; `folder` includes its episodes. `shown`: a fragment whose last frame is shown;
  // `frame_size` in pixels.
  void OnIterationEnd(const RunFolder& folder, const Fragment& shown, int frame_size) ABSL_LOCKS_EXCLUDED(mu_);
  // An update with fragments this old is finished.
  void OnUpdate(const Staleness& staleness) ABSL_LOCKS_EXCLUDED(mu_);
  // The current iteration's update failed and was undone.
  void OnUpdateUndone() { ++undone_; }

  // Adds summary and metrics. `meter` is the training thread's; `checkpoint_age` is CheckpointWriter::age().
  void Fill(const ActivityMeter& meter, absl::Duration checkpoint_age, v1::StatusReply* reply) const
      ABSL_LOCKS_EXCLUDED(mu_);
  // Of the last finished iteration; never null.
  std::shared_ptr<const View> view() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Publish(const RunFolder& folder, View view) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const v1::RunConfig& config_;
  const TrainerCounters* const counters_;
  Clock* const clock_;
  std::atomic<int64_t> undone_{0};   // updates undone since the start
  ThinnedSeries<SpeedPoint> speed_;  // of the training thread

  mutable Mutex mu_;
  std::shared_ptr<const View> view_ ABSL_GUARDED_BY(mu_) = std::make_shared<const View>();
  Staleness staleness_ ABSL_GUARDED_BY(mu_);            // of the last update
  absl::Duration iteration_time_ ABSL_GUARDED_BY(mu_);  // of the last iteration; 0: none has ended since the start
  absl::Time iteration_begin_ ABSL_GUARDED_BY(mu_) = absl::InfiniteFuture();  // start of the current iteration
};

}  // namespace craftfleet
