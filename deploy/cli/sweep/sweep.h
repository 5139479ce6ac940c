// Runs the jobs of a sweep as child processes, several at a time.

#ifndef CRAFTFLEET_DEPLOY_CLI_SWEEP_SWEEP_H_
#define CRAFTFLEET_DEPLOY_CLI_SWEEP_SWEEP_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <ostream>
#include <string>
#include <vector>

#include <absl/status/status.h>
#include <absl/time/time.h>

#include "common/base/clock.h"
#include "common/base/mutex.h"
#include "deploy/cli/sweep/child_process.h"
#include "deploy/cli/sweep/run_state.h"
#include "deploy/cli/sweep/sweep_plan.h"

namespace craftfleet {

// Finished runs are skipped, unfinished ones are resumed, and the others are started. If another process uses the
// folder of a run (such as a child that outlived its sweep), the job waits for it. The output of each run is appended
// to log.txt in its folder. Thread-safe.
class Sweep {
 public:
  struct Options {
    std::string program;                              // craftfleet-train
    int jobs = 1;                                     // child processes at a time, 1 or more
    absl::Duration report_every = absl::Seconds(30);  // time between progress lines
    absl::Duration look_again = absl::Seconds(2);     // time between checks of a folder that another process uses
  };
  // `out` and `clock` outlive the sweep. Several threads write lines to `out`, one at a time.
  Sweep(std::vector<SweepJob> jobs, const Options& options, std::ostream* out, Clock* clock);

  // Returns when every job has ended.
  //   Internal: some failed; says how many.   Cancelled: Stop() was called before all were done.
  absl::Status Run() ABSL_LOCKS_EXCLUDED(mu_);

  // Sends SIGTERM to the children and starts no more. Run() returns when they have ended.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  enum class Stage { kWaiting, kRunning, kDone, kFailed };
  struct Entry {
    Stage stage = Stage::kWaiting;
    int64_t first_steps = 0;              // environment steps done when the sweep began
    std::shared_ptr<ChildProcess> child;  // while one runs
  };

  // Finds the runs that are finished or have begun.
  void LookAtFolders() ABSL_LOCKS_EXCLUDED(mu_);
  // Runs jobs until none is left.
  void Work() ABSL_LOCKS_EXCLUDED(mu_);
  // Runs one job to its end.   Cancelled: stopping.
  absl::Status RunJob(size_t index) ABSL_LOCKS_EXCLUDED(mu_);
  // Runs one child from start to end.   Internal: it failed; includes its last line of output.
  absl::Status RunChild(size_t index, const RunState& before) ABSL_LOCKS_EXCLUDED(mu_);
  // Waits while another process uses the run's folder.   Cancelled: stopping.
  absl::Status WaitUntilFree(const SweepJob& job) ABSL_LOCKS_EXCLUDED(mu_);
  void ReportUntilOver() ABSL_LOCKS_EXCLUDED(mu_);
  std::string Progress() ABSL_LOCKS_EXCLUDED(mu_);
  void PrintLine(absl::string_view line) ABSL_LOCKS_EXCLUDED(out_mu_);
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
  size_t next_ ABSL_GUARDED_BY(mu_) = 0;             // the first job that no thread has taken
  int working_ ABSL_GUARDED_BY(mu_) = 0;             // threads in Work()
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_SWEEP_SWEEP_H_
