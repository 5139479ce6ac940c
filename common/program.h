// What every program does with its command line and signals.

#ifndef CRAFTFLEET_COMMON_PROGRAM_H_
#define CRAFTFLEET_COMMON_PROGRAM_H_

#include <functional>
#include <string>
#include <thread>
#include <vector>

#include <absl/status/status.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// Reads the absl flags, sets up the log by --log_level and --log_format, which every program has, and raises the limit
// of open files as far as it may. `usage` is what --help prints before the list of flags: what the program is for, and
// examples. Ends the process: with 0 after --help and --version, with 1 after an unknown flag, a value that does not
// parse, or an argument that is no flag; standard error says which.
void ParseFlags(absl::string_view program, absl::string_view usage, int argc, char** argv);

// The same for a program that takes arguments beside its flags: returns them, in order.
std::vector<std::string> ParseFlagsAndArguments(absl::string_view program, absl::string_view usage, int argc,
                                                char** argv);

// The exit code for `status`: 0, or 1 after printing "<program>: <message>" to standard error, as a log line with
// --log_format=json.
int ExitCode(absl::string_view program, const absl::Status& status);

// Calls `stop` at the first SIGTERM or SIGINT, on a thread of its own; the second ends the process at once, even while
// `stop` runs. One at a time in a process; make it before other threads begin.
class StopSignal {
 public:
  explicit StopSignal(std::function<void()> stop);
  ~StopSignal();
  StopSignal(const StopSignal&) = delete;
  StopSignal& operator=(const StopSignal&) = delete;

 private:
  std::thread thread_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_PROGRAM_H_
