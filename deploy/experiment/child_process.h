// Runs a program of ours beside this process.

#ifndef CRAFTFLEET_DEPLOY_EXPERIMENT_CHILD_PROCESS_H_
#define CRAFTFLEET_DEPLOY_EXPERIMENT_CHILD_PROCESS_H_

#include <sys/types.h>

#include <memory>
#include <string>
#include <vector>

#include <absl/status/statusor.h>

#include "common/mutex.h"

namespace craftfleet {

// Thread-safe. The process outlives the object unless Wait() has returned.
class ChildProcess {
 public:
  // Starts `program` with standard output and error appended to `log`, nothing on standard input, and in a process
  // group of its own: Ctrl-C on the terminal reaches it through Terminate() only, once.
  //   NotFound and others as absl::ErrnoToStatus: it can't be started.
  static absl::StatusOr<std::unique_ptr<ChildProcess>> Start(const std::string& program,
                                                             const std::vector<std::string>& arguments,
                                                             const std::string& log);
  // Waits for the end: the exit code, or 128 + signal. Once.
  int Wait() ABSL_LOCKS_EXCLUDED(mu_);
  // SIGTERM, if it still runs.
  void Terminate() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  explicit ChildProcess(pid_t pid) : pid_(pid) {}

  const pid_t pid_;
  Mutex mu_;
  bool ended_ ABSL_GUARDED_BY(mu_) = false;  // collected: the number may be another process' by now
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_EXPERIMENT_CHILD_PROCESS_H_
