#include "common/program.h"

#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <utility>
#include <vector>

#include <absl/flags/flag.h>
#include <absl/flags/parse.h>
#include <absl/flags/reflection.h>
#include <absl/strings/match.h>
#include <absl/strings/str_format.h>
#include <absl/strings/str_replace.h>

#include "common/check.h"
#include "common/log.h"
#include "common/version.h"

namespace craftfleet {

// How absl reads and writes the flags below; found by argument-dependent lookup.
bool AbslParseFlag(absl::string_view text, LogLevel* level, std::string* error) {
  if (text == "info") *level = LogLevel::kInfo;
  if (text == "warning") *level = LogLevel::kWarning;
  if (text == "error") *level = LogLevel::kError;
  const bool known = text == "info" || text == "warning" || text == "error";
  if (!known) *error = "want info, warning or error";
  return known;
}

std::string AbslUnparseFlag(LogLevel level) {
  if (level == LogLevel::kInfo) return "info";
  return level == LogLevel::kWarning ? "warning" : "error";
}

bool AbslParseFlag(absl::string_view text, LogFormat* format, std::string* error) {
  *format = text == "json" ? LogFormat::kJson : LogFormat::kText;
  const bool known = text == "json" || text == "text";
  if (!known) *error = "want text or json";
  return known;
}

std::string AbslUnparseFlag(LogFormat format) { return format == LogFormat::kJson ? "json" : "text"; }

}  // namespace craftfleet

ABSL_FLAG(craftfleet::LogLevel, log_level, craftfleet::LogLevel::kInfo,
          "what is logged to standard error: info, warning (and worse) or error");
ABSL_FLAG(craftfleet::LogFormat, log_format, craftfleet::LogFormat::kText,
          "one line an event: text, or json for programs that collect logs");

namespace craftfleet {
namespace {

constexpr char kSignalByte = 's';
constexpr char kEndByte = 'e';
constexpr int kForcedExitCode = 130;

// Written by the signal handler, which can't be handed anything.
int g_signal_pipe[2] = {-1, -1};
std::atomic<int> g_signals{0};

void OnSignal(int /*signal*/) {
  // Here, because the thread may be busy stopping.
  if (++g_signals > 1) _exit(kForcedExitCode);
  const int saved_errno = errno;
  [[maybe_unused]] const ssize_t written = write(g_signal_pipe[1], &kSignalByte, 1);
  errno = saved_errno;
}

void PrintHelp(absl::string_view program, absl::string_view usage) {
  std::map<absl::string_view, const absl::CommandLineFlag*> ours;
  for (const auto& [name, flag] : absl::GetAllFlags()) {
    if (!absl::StrContains(flag->Filename(), "absl/")) ours[name] = flag;
  }
  absl::PrintF("%s\n", usage);
  if (!ours.empty()) absl::PrintF("\nFlags of %s:\n", program);
  for (const auto& [name, flag] : ours) {
    const std::string value = flag->DefaultValue();
    absl::PrintF("  --%s%s\n      %s\n", name, value.empty() ? "" : absl::StrFormat(" (default %s)", value),
                 absl::StrReplaceAll(flag->Help(), {{"\n", "\n      "}}));
  }
  absl::PrintF("  --help, --version\n");
}

// Each connection is an open file, and shells begin with a limit of 1,024 of them.
void RaiseFileLimit() {
  rlimit limit = {};
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  setrlimit(RLIMIT_NOFILE, &limit);
}

}  // namespace

std::vector<std::string> ParseFlagsAndArguments(absl::string_view program, absl::string_view usage, int argc,
                                                char** argv) {
  // gRPC's own log speaks of internals; what matters reaches the user through our messages.
  setenv("GRPC_VERBOSITY", "NONE", /*overwrite=*/0);
  // A file at its size limit is an error of the write, like a full disk, and not the end.
  signal(SIGXFSZ, SIG_IGN);
  RaiseFileLimit();
  for (int i = 1; i < argc; ++i) {
    const absl::string_view argument = argv[i];
    if (argument == "--help" || argument == "-help" || argument == "-h") {
      PrintHelp(program, usage);
      std::exit(0);
    }
    if (argument == "--version") {
      absl::PrintF("%s\n", VersionText(program));
      std::exit(0);
    }
  }
  const std::vector<char*> rest = absl::ParseCommandLine(argc, argv);
  SetUpLog({absl::GetFlag(FLAGS_log_level), absl::GetFlag(FLAGS_log_format), std::string(program)});
  return {rest.begin() + 1, rest.end()};
}

void ParseFlags(absl::string_view program, absl::string_view usage, int argc, char** argv) {
  const std::vector<std::string> rest = ParseFlagsAndArguments(program, usage, argc, argv);
  if (!rest.empty()) {
    absl::FPrintF(stderr, "%s: \"%s\" is no flag; see %s --help\n", program, rest[0], program);
    std::exit(1);
  }
}

int ExitCode(absl::string_view program, const absl::Status& status) {
  if (status.ok()) return 0;
  if (absl::GetFlag(FLAGS_log_format) == LogFormat::kJson) {
    LogError("%s", status.message());
  } else {
    absl::FPrintF(stderr, "%s: %s\n", program, status.message());
  }
  return 1;
}

StopSignal::StopSignal(std::function<void()> stop) {
  CRAFTFLEET_CHECK(pipe(g_signal_pipe) == 0);
  g_signals = 0;
  thread_ = std::thread([stop = std::move(stop)] {
    char byte = 0;
    while (read(g_signal_pipe[0], &byte, 1) == 1 && byte == kSignalByte) stop();
  });
  struct sigaction action = {};
  action.sa_handler = OnSignal;
  action.sa_flags = SA_RESTART;
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
}

StopSignal::~StopSignal() {
  signal(SIGTERM, SIG_DFL);
  signal(SIGINT, SIG_DFL);
  [[maybe_unused]] const ssize_t written = write(g_signal_pipe[1], &kEndByte, 1);
  thread_.join();
  close(g_signal_pipe[0]);
  close(g_signal_pipe[1]);
}

}  // namespace craftfleet
