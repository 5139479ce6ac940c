// A child process that runs one of our programs.

#ifndef CRAFTFLEET_DEPLOY_CLI_SWEEP_CHILD_PROCESS_H_
#define CRAFTFLEET_DEPLOY_CLI_SWEEP_CHILD_PROCESS_H_

#include <sys/types.h>

#include <memory>
#include <string>
#include <vector>

#include <absl/status/statusor.h>

#include "common/base/mutex.h"

namespace craftfleet {

// Thread-safe. The process outlives the object unless Wait() has returned.
class ChildProcess {
 public:
  // Starts `program` with its output and errors appended to `log`, with empty standard input, and in its own process
  // group, so that Ctrl-C on the terminal reaches it only through Terminate().
  //   NotFound and others as absl::ErrnoToStatus: it can't be started.
  static absl::StatusOr<std::unique_ptr<ChildProcess>> Start(const std::string& program,
                                                             const std::vector<std::string>& arguments,
                                                             const std::string& log);
  // Waits until the process ends; returns its exit code, or 128 + signal. To be called once.
  int Wait() ABSL_LOCKS_EXCLUDED(mu_);
  // Sends SIGTERM if the process is still running.
  void Terminate() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  explicit ChildProcess(pid_t pid) : pid_(pid) {}

  const pid_t pid_;
  Mutex mu_;
  bool ended_ ABSL_GUARDED_BY(mu_) = false;  // reaped: its id may belong to another process now
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_DEPLOY_CLI_SWEEP_CHILD_PROCESS_H_
