// Command line, standard output, exit codes and signals, the same in every program.

#pragma once

#include <csignal>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

#include "common/process/help.h"

namespace craftfleet {

// Parses the Abseil flags that the program has, sets up the log from --log_level and --log_format, which every program
// has, and raises the soft limit of open files as far as possible. Ends the process: with 0 after --help, --helpfull,
// --help_json and --version; with 1 after an unknown flag, a value that does not parse, an argument that is not a flag,
// or help that can't be written, each with a message on standard error.
void ParseFlags(const ProgramHelp& program, int argc, char** argv);

// The same for a program with positional arguments: returns them in order.
std::vector<std::string> ParseFlagsAndArguments(const ProgramHelp& program, int argc, char** argv);

// Flushes standard output.
//   DataLoss: not all output could be written, for example because the disk is full. OK if the reader of a pipe closed
//   it: it did not want more.
absl::Status FinishStandardOutput();

// Called where standard input seems to end.   DataLoss: it can't be read, with the reason in errno.
absl::Status CheckStandardInput();

// The exit code for `status`, to be called after all output: 0, or 1 after printing "<program>: <message>" to standard
// error (a log line with --log_format=json). Also 1 if standard output could not be written.
int ExitCode(absl::string_view program, const absl::Status& status);

// From now on SIGPIPE does not end the program when the reader of its output exits (`craftfleet train | head`). For
// programs whose result is more than their output; call it first.
void OutliveReaders();

// The exit code of a program that a signal stopped before its work was complete, and of one that a second signal ended,
// see StopSignal.
inline constexpr int kStoppedExitCode = 130;

// Calls `stop` once, on a thread of its own, at the first SIGTERM, SIGINT or SIGHUP (the terminal was closed). A second
// SIGTERM or SIGINT ends the process at once, even while `stop` runs, unless it comes within half a second: timeout(1)
// sends two. That is so also after the object is gone, while the process ends. SIGHUP never does, because a shell and
// the kernel may both send it. A program started with nohup keeps ignoring SIGHUP. None of them interrupts the thread
// that has the object (stop_signals.h). At most one object at a time in a process; create it before other threads
// start.
class StopSignal {
 public:
  explicit StopSignal(std::function<void()> stop);
  ~StopSignal();
  StopSignal(const StopSignal&) = delete;
  StopSignal& operator=(const StopSignal&) = delete;

 private:
  sigset_t before_;  // the signals that were blocked
  std::thread thread_;
  bool handles_hangup_ = false;
};

}  // namespace craftfleet
