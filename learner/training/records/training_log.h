// Writes the results of each iteration to the run folder's logs.

#pragma once

#include <cstdint>
#include <vector>

#include "common/base/types.h"
#include "learner/ppo/update_stats.h"
#include "learner/run/run_folder.h"
#include "learner/training/records/disk_wait.h"
#include "learner/training/staleness.h"

namespace craftfleet {

// Owned by one thread.
class TrainingLog {
 public:
  static constexpr int64_t kMaxWaitingBytes = 64 << 20;  // about 100,000 episodes

  // `folder` and `disk` outlive this. `max_waiting_bytes`: while the disk is full, the most that is buffered in memory
  // before Flush blocks.
  TrainingLog(RunFolder* folder, DiskWait* disk, int64_t max_waiting_bytes = kMaxWaitingBytes)
      : folder_(folder), disk_(disk), max_waiting_bytes_(max_waiting_bytes) {}

  // Adds the episodes that ended in `fragments`, in their order, and a point at `env_steps` to every curve and
  // histogram (FORMATS.md, section 6). `steps_per_second`: of this start so far.
  void AddIteration(int64_t env_steps, const std::vector<Fragment>& fragments, const UpdateStats& stats,
                    double steps_per_second);

  // Adds a point at `env_steps` to the curves of asynchronous play. `dropped`: fragments that were too old, so far.
  void AddStaleness(int64_t env_steps, const Staleness& staleness, int64_t dropped);

  // Writes what was added. If the disk is full, the rest is kept for a later call; with more than `max_waiting_bytes`
  // of it, waits for space until training is asked to stop or another learner has taken over the folder.
  void Flush();

 private:
  RunFolder* const folder_;
  DiskWait* const disk_;
  const int64_t max_waiting_bytes_;
};

}  // namespace craftfleet
