// What the live page shows of training: curves, success rates, speed and a frame.

#ifndef CRAFTFLEET_LEARNER_TRAINING_RECORDS_TRAINING_VIEW_H_
#define CRAFTFLEET_LEARNER_TRAINING_RECORDS_TRAINING_VIEW_H_

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "common/base/mutex.h"
#include "common/base/types.h"
#include "learner/run/run_folder.h"
#include "learner/run/score_curve.h"

namespace craftfleet {

// Written by the training thread at the end of each iteration, read by any.
class TrainingView {
 public:
  struct SpeedPoint {
    int64_t env_steps = 0;        // accepted, over all starts of the run
    double steps_per_second = 0;  // of the iteration that ended there
  };
  struct Moment {
    int64_t number = 0;  // differs from that of every other moment of this process
    int64_t env_steps = 0;
    int64_t episodes = 0;
    std::vector<CurvePoint> curve;
    std::vector<SpeedPoint> speed;  // since this start
    AchievementPercentages rates = {};
    int frame_size = 0;  // pixels
    std::string frame;   // what an agent saw at the end, uint8[frame_size,frame_size,3]; empty: none yet
  };

  // `folder`'s score and curve of earlier starts.
  void OnStart(const RunFolder& folder, int64_t env_steps) ABSL_LOCKS_EXCLUDED(mu_);
  // The current iteration is finished; `folder` includes its episodes. `shown`: a fragment whose last frame is
  // shown; `frame_size` in pixels.
  void OnIterationEnd(const RunFolder& folder, int64_t env_steps, double steps_per_second, const Fragment& shown,
                      int frame_size) ABSL_LOCKS_EXCLUDED(mu_);

  // As of the last finished iteration; never null.
  std::shared_ptr<const Moment> Now() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Publish(const RunFolder& folder, int64_t env_steps, int frame_size, std::string frame) ABSL_LOCKS_EXCLUDED(mu_);

  ThinnedSeries<SpeedPoint> speed_;  // of the training thread
  mutable Mutex mu_;
  std::shared_ptr<const Moment> now_ ABSL_GUARDED_BY(mu_) = std::make_shared<const Moment>();
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_TRAINING_RECORDS_TRAINING_VIEW_H_
