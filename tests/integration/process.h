// Runs a program of the build in a test.

#pragma once

#include <sys/types.h>

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>
#include <absl/time/time.h>

namespace craftfleet {

// How long tests wait for programs. Sanitizer builds are slow.
inline constexpr absl::Duration kPatience = absl::Seconds(240);

// The process is killed by the destructor, and by the kernel when the thread that started it ends, so that no process
// outlives a test that crashes or is killed. The test fails if a process that it did not wait for has crashed, or a
// sanitizer has ended it. Thread-compatible.
class Process {
 public:
  // Starts `program`, in build/bin or a path with a slash, with standard output and error in the files
  // LOG_PREFIX.out and LOG_PREFIX.err, which are replaced.
  //   NotFound: no such program.   Others: a log that can't be written.
  static absl::StatusOr<std::unique_ptr<Process>> Start(const std::string& program,
                                                        const std::vector<std::string>& arguments,
                                                        const std::string& log_prefix);
  ~Process();
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  // Sends `signal`, unless Wait has already reported the end.
  void Signal(int signal);
  // Waits for the end; returns the exit code, or 128 + signal. Nothing if the process still runs after `timeout`.
  std::optional<int> Wait(absl::Duration timeout);
  // Sends SIGKILL and waits for the end. Idempotent.
  void Kill();

  // Waits until `text` is in standard output or error. False: not within `timeout`, or before the process ended.
  bool WaitForText(absl::string_view text, absl::Duration timeout) const;
  // The word after `before` in standard error, as programs that listen print it: "listening on 127.0.0.1:41234",
  // "status on 127.0.0.1:41235".
  //   DeadlineExceeded: not printed within `timeout`; the message has what was printed instead.
  absl::StatusOr<std::string> WaitForAddress(absl::string_view before = "listening on ",
                                             absl::Duration timeout = absl::Seconds(20)) const;

  std::string Out() const;
  std::string Err() const;
  pid_t pid() const { return pid_; }

 private:
  Process(pid_t pid, int pid_descriptor, std::string log_prefix);
  // Waits for the process to end without reaping it. False: it still runs.
  bool WaitForEnd(absl::Duration timeout) const;
  // Fails the test if the process, which has ended by itself, crashed.
  void ReportCrash() const;

  const pid_t pid_;
  const int pid_descriptor_;
  const std::string log_prefix_;
  std::optional<int> exit_code_;
};

}  // namespace craftfleet
