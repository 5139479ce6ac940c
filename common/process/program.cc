#include "common/process/program.h"

#include <fcntl.h>
#include <poll.h>
#include <pwd.h>
#include <signal.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <exception>
#include <new>
#include <optional>
#include <stdexcept>
#include <system_error>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/flags/parse.h>
#include <absl/flags/reflection.h>
#include <absl/strings/ascii.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/strings/strip.h>
#include <absl/synchronization/mutex.h>
#include <google/protobuf/stubs/logging.h>

#include "common/base/check.h"
#include "common/base/clock.h"
#include "common/base/openmp_places.h"
#include "common/base/stop_signals.h"
#include "common/process/closest_name.h"
#include "common/process/flag_values.h"
#include "common/process/help.h"
#include "common/process/version.h"
#include "common/telemetry/limited_log.h"
#include "common/telemetry/log.h"

namespace craftfleet {

constexpr char kLogLevels[] = "info, warning or error";
constexpr char kLogFormats[] = "text or json";

// How absl reads and writes the flags below; found by argument-dependent lookup.
bool AbslParseFlag(absl::string_view text, LogLevel* level, std::string* error) {
  if (text == "info") *level = LogLevel::kInfo;
  if (text == "warning") *level = LogLevel::kWarning;
  if (text == "error") *level = LogLevel::kError;
  const bool known = text == "info" || text == "warning" || text == "error";
  if (!known) *error = kLogLevels;
  return known;
}

std::string AbslUnparseFlag(LogLevel level) {
  if (level == LogLevel::kInfo) return "info";
  return level == LogLevel::kWarning ? "warning" : "error";
}

bool AbslParseFlag(absl::string_view text, LogFormat* format, std::string* error) {
  *format = text == "json" ? LogFormat::kJson : LogFormat::kText;
  const bool known = text == "json" || text == "text";
  if (!known) *error = kLogFormats;
  return known;
}

std::string AbslUnparseFlag(LogFormat format) { return format == LogFormat::kJson ? "json" : "text"; }

}  // namespace craftfleet

ABSL_FLAG(craftfleet::LogLevel, log_level, craftfleet::LogLevel::kInfo,
          "lowest level that is logged to standard error: info, warning or error");
ABSL_FLAG(craftfleet::LogFormat, log_format, craftfleet::LogFormat::kText,
          "format of log lines: text, or json for log collectors");

namespace craftfleet {
namespace {

constexpr char kSignalByte = 's';
constexpr char kEndByte = 'e';

// Globals, because a signal handler has no context argument.
int g_signal_pipe[2] = {-1, -1};
std::atomic<int64_t> g_first_signal_ns{0};  // of CLOCK_MONOTONIC; 0: none yet; SIGHUP is not counted

// timeout(1) sends SIGTERM to its child, and at once to the child's group.
constexpr int64_t kOneRequestNs = 500'000'000;

std::terminate_handler g_terminate = nullptr;

void OnSignal(int signal) {
  const int saved_errno = errno;
  if (signal != SIGHUP) {
    timespec now = {};
    clock_gettime(CLOCK_MONOTONIC, &now);
    const int64_t now_ns = int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
    int64_t first_ns = 0;
    const bool is_first = g_first_signal_ns.compare_exchange_strong(first_ns, now_ns);
    // Exits here, because the thread of StopSignal may be busy with the first signal.
    if (!is_first && now_ns - first_ns > kOneRequestNs) _exit(kStoppedExitCode);
  }
  [[maybe_unused]] const ssize_t written = write(g_signal_pipe[1], &kSignalByte, 1);
  errno = saved_errno;
}

// Opens standard streams that the program was started without (`2>&-`): otherwise a file or socket gets the number, and
// with it what is meant for the stream. Reading and writing still fail.
void OpenMissingStreams() {
  for (const int stream : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    if (fcntl(stream, F_GETFD) >= 0) continue;
    [[maybe_unused]] const int lowest = open("/dev/null", stream == STDIN_FILENO ? O_WRONLY : O_RDONLY);
  }
}

// Logs the messages of Protobuf's own log, such as that a peer's text is not UTF-8.
void OnProtobufLog(google::protobuf::LogLevel level, const char* /*file*/, int /*line*/, const std::string& message) {
  static RealClock& clock = *new RealClock;  // never destroyed: threads may outlive main
  static LimitedLog& log = *new LimitedLog(&clock);
  if (level == google::protobuf::LOGLEVEL_FATAL) return LogError("protobuf: %s", message);
  log.Warn("protobuf", absl::StrCat("protobuf: ", message));
}

// Each connection needs a file descriptor, and shells set a soft limit of 1,024. A server of gRPC 1.51 that runs out of
// them accepts no connection ever again.
void RaiseFileLimit() {
  rlimit limit = {};
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  setrlimit(RLIMIT_NOFILE, &limit);
}

// What the program says, instead of a crash, when the system refuses it a thread or memory and nobody catches that.
[[noreturn]] void OnUncaught() {
  try {
    if (const std::exception_ptr error = std::current_exception()) std::rethrow_exception(error);
  } catch (const std::system_error& error) {
    if (error.code() == std::errc::resource_unavailable_try_again) {
      LogError(
          "cannot start another thread: raise the limit of threads (ulimit -u, pids.max of the container, TasksMax of "
          "systemd), or start fewer (--threads)");
      _exit(1);
    }
    LogError("%s", error.what());
    _exit(1);
  } catch (const std::runtime_error& error) {
    // What libraries throw instead.
    LogError("%s: it may be a limit of this system (ulimit -a, the container's)", error.what());
    _exit(1);
  } catch (const std::bad_alloc&) {
    LogError("out of memory: raise the limit (ulimit -v, the container's), or lower what needs it");
    _exit(1);
  } catch (...) {  // NOLINT(bugprone-empty-catch): ends as before
  }
  g_terminate();
  _exit(1);
}

void EndAt(int signal) { _exit(128 + signal); }

// In process 1, as in a container, lets SIGTERM and SIGINT end the process as they would end another one, until
// StopSignal handles them: the kernel drops signals to process 1 that nothing handles.
void LetSignalsEndProcess1() {
  if (getpid() != 1) return;
  signal(SIGTERM, EndAt);
  signal(SIGINT, EndAt);
}

// --fromenv and --tryfromenv, which health checks of images have.
bool TakesVariables(const absl::CommandLineFlag& flag) { return absl::EndsWith(flag.Name(), "fromenv"); }

// Not Abseil's others, which bypass the checks here: a --flagfile may have unknown flags.
absl::CommandLineFlag* FindFlag(const ProgramHelp& program, absl::string_view name) {
  absl::CommandLineFlag* const flag = absl::FindCommandLineFlag(name);
  return flag != nullptr && (TakesVariables(*flag) || HasFlag(program, *flag)) ? flag : nullptr;
}

// The flag of the program that "--lanes=3", "-lanes" or "--noresume" sets; null if there is no such flag.
absl::CommandLineFlag* FlagOf(const ProgramHelp& program, absl::string_view argument) {
  absl::string_view name = argument.substr(0, argument.find('='));
  if (!absl::ConsumePrefix(&name, "--")) absl::ConsumePrefix(&name, "-");
  absl::CommandLineFlag* flag = FindFlag(program, name);
  if (flag == nullptr && absl::ConsumePrefix(&name, "no")) {
    flag = FindFlag(program, name);
    if (flag != nullptr && !flag->IsOfType<bool>()) flag = nullptr;
  }
  return flag;
}

std::string FlagLike(const ProgramHelp& program, absl::string_view name) {
  std::vector<std::string> names;
  for (const auto& [known, flag] : absl::GetAllFlags()) {
    if (HasFlag(program, *flag)) names.emplace_back(known);
  }
  std::sort(names.begin(), names.end());
  for (const auto& [before, now] : {std::pair("json", "out"), std::pair("video_size", "size")}) {  // until version 0.1
    if (name == before && std::count(names.begin(), names.end(), now) > 0) return now;
  }
  const std::string closest = ClosestName(name, names);
  const bool negated = closest.empty() && absl::ConsumePrefix(&name, "no");
  return negated ? ClosestName(name, names) : closest;
}

[[noreturn]] void Refuse(const ProgramHelp& program, absl::string_view what, absl::string_view suggestion) {
  absl::FPrintF(stderr, "%s: %s%s; see %s --help\n", program.name, what,
                suggestion.empty() ? "" : absl::StrCat(" (did you mean --", suggestion, "?)"), program.name);
  std::exit(1);
}

template <typename... Types>
bool IsOneOf(const absl::CommandLineFlag& flag) {
  return (flag.IsOfType<Types>() || ...);
}

// The values that `flag` accepts instead of `value`.
absl::string_view Accepted(const absl::CommandLineFlag& flag, absl::string_view value) {
  const bool is_integer =
      IsOneOf<int32_t, int64_t, uint64_t, Count, std::optional<int32_t>, std::optional<uint64_t>, std::optional<Count>>(
          flag);
  const bool is_whole = !value.empty() && std::all_of(value.begin(), value.end(), absl::ascii_isdigit);
  if (is_integer && is_whole) return "a smaller number";
  if (flag.IsOfType<bool>()) return "true or false";
  if (IsOneOf<int32_t, int64_t, std::optional<int32_t>>(flag)) return "a whole number";
  if (IsOneOf<uint64_t, std::optional<uint64_t>>(flag)) return "a whole number, at least 0";
  if (IsOneOf<Count, std::optional<Count>>(flag)) return Count::kWanted;
  if (flag.IsOfType<TimeSpan>()) return TimeSpan::kWanted;
  if (flag.IsOfType<LogLevel>()) return kLogLevels;
  if (flag.IsOfType<LogFormat>()) return kLogFormats;
  if (flag.IsOfType<std::optional<std::string>>()) return "a value, or omit the flag";
  return flag.IsOfType<double>() ? "a number" : "another value";
}

// Whether absl takes an empty value of `flag` as if the flag were not given.
bool IsOptional(const absl::CommandLineFlag& flag) {
  return IsOneOf<std::optional<int32_t>, std::optional<uint64_t>, std::optional<Count>, std::optional<std::string>>(
      flag);
}

// Refuses a value that absl would refuse without naming the program and the accepted values, and an empty one, as of
// --seed=$SEED without that variable, that would silently stand for the default.
void CheckValue(const ProgramHelp& program, absl::CommandLineFlag* flag, absl::string_view value) {
  if (TakesVariables(*flag)) return;  // it acts when it is set
  std::string error;
  if (!(value.empty() && IsOptional(*flag)) && flag->ParseFrom(value, &error)) return;
  Refuse(program, absl::StrCat("--", flag->Name(), "=", value, ", want ", Accepted(*flag, value)), "");
}

// The folder that "~" stands for; empty: unknown.
std::string HomeFolder() {
  if (const char* const home = std::getenv("HOME"); home != nullptr && *home != '\0') return home;
  const passwd* const user = getpwuid(getuid());
  return user != nullptr ? user->pw_dir : "";
}

// A shell expands "~/" at the start of a word only, so not in --logdir=~/runs.
void ExpandHome(const ProgramHelp& program, int argc, char** argv) {
  static auto* const expanded = new std::deque<std::string>;  // argv points into it until the end
  for (int i = 1; i < argc; ++i) {
    const absl::string_view argument = argv[i];
    if (argument == "--") return;
    const size_t equals = argument.find('=');
    if (!absl::StartsWith(argument, "-") || equals == absl::string_view::npos) continue;
    absl::string_view value = argument.substr(equals + 1);
    const absl::CommandLineFlag* const flag = FlagOf(program, argument);
    if (flag == nullptr || !IsOneOf<std::string, std::optional<std::string>>(*flag)) continue;
    if (!absl::ConsumePrefix(&value, "~") || (!value.empty() && value[0] != '/')) continue;
    const std::string home = HomeFolder();
    if (home.empty()) Refuse(program, absl::StrCat(argument, ": HOME is not set"), "");
    argv[i] = expanded->emplace_back(absl::StrCat(argument.substr(0, equals + 1), home, value)).data();
  }
}

// Before absl parses the flags: its own errors neither suggest a flag nor name the accepted values.
void RefuseBadFlags(const ProgramHelp& program, int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    const absl::string_view argument = argv[i];
    if (argument == "--") return;
    if (argument.size() < 2 || argument[0] != '-') continue;
    absl::CommandLineFlag* flag = FlagOf(program, argument);
    if (flag == nullptr) {
      absl::string_view name = argument.substr(0, argument.find('='));
      while (absl::ConsumePrefix(&name, "-")) {
      }
      Refuse(program, absl::StrFormat("unknown flag '%s'", name), FlagLike(program, name));
    }
    if (const size_t equals = argument.find('='); equals != absl::string_view::npos) {
      if (!absl::EndsWith(argument.substr(0, equals), absl::StrCat("-", flag->Name()))) {
        Refuse(program, absl::StrCat(argument, ": --no", flag->Name(), " takes no value"), "");
      }
      CheckValue(program, flag, argument.substr(equals + 1));
    } else if (!flag->IsOfType<bool>()) {
      if (++i == argc)
        Refuse(program, absl::StrFormat("--%s needs a value: --%s=VALUE", flag->Name(), flag->Name()), "");
      CheckValue(program, flag, argv[i]);
    }
  }
}

// If `argument` requests help or the version, prints it and ends the program.
void AnswerHelp(const ProgramHelp& program, absl::string_view argument) {
  std::string text;
  if (argument == "--help" || argument == "-help" || argument == "-h") text = ShortHelp(program);
  if (argument == "--helpfull") text = FullHelp(program);
  if (argument == "--help_json") text = HelpJson(program);
  if (argument == "--version") text = VersionText(program.name) + "\n";
  if (text.empty()) return;
  std::fputs(text.c_str(), stdout);
  std::exit(ExitCode(program.name, absl::OkStatus()));
}

// Whether standard output is a pipe or socket whose reader has closed it.
bool ReaderIsGone() {
  pollfd output = {STDOUT_FILENO, POLLOUT, 0};
  return poll(&output, 1, 0) == 1 && (output.revents & (POLLERR | POLLHUP)) != 0;
}

}  // namespace

std::vector<std::string> ParseFlagsAndArguments(const ProgramHelp& program, int argc, char** argv) {
  OpenMissingStreams();
  google::protobuf::SetLogHandler(OnProtobufLog);
  // gRPC's own log describes its internals; relevant errors are logged by this project's code.
  setenv("GRPC_VERBOSITY", "NONE", /*overwrite=*/0);
  // Exceeding the file size limit becomes a write error, like a full disk, instead of ending the process.
  signal(SIGXFSZ, SIG_IGN);
  RaiseFileLimit();
  UseAllOpenMpPlaces();
  LetSignalsEndProcess1();
  // Packaged Abseil looks for lock cycles at each lock of gRPC, under one lock for the process. Tests keep that check.
  absl::SetMutexDeadlockDetectionMode(absl::OnDeadlockCycle::kIgnore);
  for (int i = 1; i < argc && absl::string_view(argv[i]) != "--"; ++i) {
    AnswerHelp(program, argv[i]);
  }
  ExpandHome(program, argc, argv);
  RefuseBadFlags(program, argc, argv);
  const std::vector<char*> rest = absl::ParseCommandLine(argc, argv);
  SetUpLog({absl::GetFlag(FLAGS_log_level), absl::GetFlag(FLAGS_log_format), std::string(program.name)});
  g_terminate = std::set_terminate(OnUncaught);
  return {rest.begin() + 1, rest.end()};
}

void ParseFlags(const ProgramHelp& program, int argc, char** argv) {
  const std::vector<std::string> rest = ParseFlagsAndArguments(program, argc, argv);
  if (rest.empty()) return;
  Refuse(program, absl::StrFormat("\"%s\" is not a flag", rest[0]), FlagOf(program, rest[0]) == nullptr ? "" : rest[0]);
}

absl::Status FinishStandardOutput() {
  errno = 0;
  const bool flushed = std::fflush(stdout) == 0;
  const int error_number = errno;
  if ((flushed && std::ferror(stdout) == 0) || ReaderIsGone()) return absl::OkStatus();
  const std::string why = error_number == 0 ? "an earlier write failed" : std::generic_category().message(error_number);
  return absl::DataLossError(absl::StrCat("cannot write all of standard output: ", why));
}

absl::Status CheckStandardInput() {
  if (std::ferror(stdin) == 0) return absl::OkStatus();
  return absl::DataLossError(absl::StrCat("cannot read standard input: ", std::generic_category().message(errno)));
}

int ExitCode(absl::string_view program, const absl::Status& status) {
  const absl::Status printed = FinishStandardOutput();
  const absl::Status& error = status.ok() ? printed : status;
  if (error.ok()) return 0;
  if (absl::GetFlag(FLAGS_log_format) == LogFormat::kJson) {
    LogError("%s", error.message());
  } else {
    absl::FPrintF(stderr, "%s: %s\n", program, error.message());
  }
  return 1;
}

void OutliveReaders() { signal(SIGPIPE, SIG_IGN); }

StopSignal::StopSignal(std::function<void()> stop) {
  CRAFTFLEET_CHECK(pipe(g_signal_pipe) == 0);
  g_first_signal_ns = 0;
  before_ = MaskStopSignals(SIG_BLOCK);
  thread_ = std::thread([stop = std::move(stop)] {
    MaskStopSignals(SIG_UNBLOCK);
    bool stopped = false;
    char byte = 0;
    while (read(g_signal_pipe[0], &byte, 1) == 1 && byte == kSignalByte) {
      if (!stopped) stop();
      stopped = true;
    }
  });
  struct sigaction action = {};
  action.sa_handler = OnSignal;
  action.sa_flags = SA_RESTART;
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
  struct sigaction before = {};
  sigaction(SIGHUP, nullptr, &before);
  handles_hangup_ = before.sa_handler != SIG_IGN;
  if (handles_hangup_) sigaction(SIGHUP, &action, nullptr);
}

StopSignal::~StopSignal() {
  [[maybe_unused]] const ssize_t written = write(g_signal_pipe[1], &kEndByte, 1);
  thread_.join();
  // Those that no thread has taken yet must not end the process either.
  const sigset_t signals = StopSignals();
  const timespec no_wait = {};
  while (sigtimedwait(&signals, nullptr, &no_wait) > 0) continue;
  // OnSignal stays for SIGTERM and SIGINT, and SIGHUP is ignored: the process is about to end, and only a second
  // SIGTERM or SIGINT may change its exit code.
  if (handles_hangup_) signal(SIGHUP, SIG_IGN);
  pthread_sigmask(SIG_SETMASK, &before_, nullptr);
  // The pipe stays open: a thread of a library may still be in the handler.
}

}  // namespace craftfleet

// Before the libraries are initialised, which takes LibTorch half a second. Sanitizers are not ready at this point.
#if !defined(__SANITIZE_THREAD__) && !defined(__SANITIZE_ADDRESS__) && !defined(__clang__)
namespace {
__attribute__((section(".preinit_array"), used)) void (*g_before_libraries)() = craftfleet::LetSignalsEndProcess1;
}  // namespace
#endif
