// Runs the jobs of a sweep as child processes, some at a time, whatever state their folders are in.

#ifndef CRAFTFLEET_DEPLOY_EXPERIMENT_SWEEP_H_
#define CRAFTFLEET_DEPLOY_EXPERIMENT_SWEEP_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <ostream>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/time/time.h>

#include "common/clock.h"
#include "common/mutex.h"
#include "deploy/experiment/child_process.h"
#include "deploy/experiment/run_state.h"
#include "deploy/experiment/sweep_plan.h"

namespace craftfleet {

// A job whose run is finished is left alone, one that has begun is gone on with, any other is started. A folder that
// another process uses (a child that outlived the sweep that started it, say) is waited for. Each run's output is
// appended to log.txt in its folder. Thread-safe.
class Sweep {
 public:
  struct Options {
    std::string program;                              // craftfleet-train
    int jobs = 1;                                     // child processes at a time, 1 or more
    absl::Duration report_every = absl::Seconds(30);  // time between progress lines
    absl::Duration look_again = absl::Seconds(2);     // time between looks at a folder that another process uses
  };
  // `out` and `clock` outlive the sweep. Lines go to `out` from several threads, one at a time.
  Sweep(std::vector<SweepJob> jobs, const Options& options, std::ostream* out, Clock* clock);

  // Returns when every job is over.
  //   Internal: some failed; says how many.   Cancelled: Stop() was called before all were done.
  absl::Status Run() ABSL_LOCKS_EXCLUDED(mu_);

  // Passes SIGTERM on to the children and starts no more. Run() returns when they have ended.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  enum class Stage { kWaiting, kRunning, kDone, kFailed };
  struct Entry {
    Stage stage = Stage::kWaiting;
    int64_t first_steps = 0;              // environment steps done when the sweep began
    std::shared_ptr<ChildProcess> child;  // while one runs
  };

  // Finds out what is done already.
  void LookAtFolders() ABSL_LOCKS_EXCLUDED(mu_);
  // Runs jobs until none is left.
  void Work() ABSL_LOCKS_EXCLUDED(mu_);
  // Runs one to its end. Cancelled: stopping.
  absl::Status RunJob(size_t index) ABSL_LOCKS_EXCLUDED(mu_);
  // One child from start to end. Internal: it failed; has its last line.
  absl::Status RunChild(size_t index, const RunState& before) ABSL_LOCKS_EXCLUDED(mu_);
  // Waits while another process uses `folder`. Cancelled: stopping.
  absl::Status WaitUntilFree(const SweepJob& job) ABSL_LOCKS_EXCLUDED(mu_);
  void ReportUntilOver() ABSL_LOCKS_EXCLUDED(mu_);
  std::string Progress() ABSL_LOCKS_EXCLUDED(mu_);
  void Say(absl::string_view line) ABSL_LOCKS_EXCLUDED(out_mu_);
  int Count(Stage stage) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const std::vector<SweepJob> jobs_;
  const Options options_;
  Clock* const clock_;
  absl::Time start_;  // set by Run() before its threads begin

  Mutex out_mu_;
  std::ostream* const out_ ABSL_PT_GUARDED_BY(out_mu_);

  Mutex mu_;
  CondVar changed_;
  std::vector<Entry> entries_ ABSL_GUARDED_BY(mu_);  // by job
  size_t next_ ABSL_GUARDED_BY(mu_) = 0;             // first that nobody has taken
  int working_ ABSL_GUARDED_BY(mu_) = 0;             // threads in Work()
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_EXPERIMENT_SWEEP_H_
