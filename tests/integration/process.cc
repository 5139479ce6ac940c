#include "tests/integration/process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/str_format.h>
#include <absl/time/clock.h>
#include <gtest/gtest.h>

#include "common/base/check.h"
#include "common/io/files.h"
#include "tests/fakes/test_paths.h"

namespace craftfleet {
namespace {

constexpr absl::Duration kLookInterval = absl::Milliseconds(10);  // between reads of the logs

absl::StatusOr<int> OpenLog(const std::string& path) {
  const int descriptor = open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_APPEND | O_CLOEXEC, 0644);
  if (descriptor < 0) return FileError(errno, "cannot write", path);
  return descriptor;
}

// Makes only calls that are safe between fork and exec in a process with threads.
[[noreturn]] void RunChild(const std::vector<char*>& arguments, int out, int err) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  dup2(out, STDOUT_FILENO);
  dup2(err, STDERR_FILENO);
  execv(arguments[0], arguments.data());
  _exit(127);
}

}  // namespace

absl::StatusOr<std::unique_ptr<Process>> Process::Start(const std::string& program,
                                                        const std::vector<std::string>& arguments,
                                                        const std::string& log_prefix) {
  std::vector<std::string> words =
      absl::StrContains(program, '/') ? std::vector<std::string>{program} : BuiltCommand(program);
  words.insert(words.end(), arguments.begin(), arguments.end());
  if (access(words[0].c_str(), X_OK) != 0) return FileError(errno, "cannot run", words[0]);
  std::vector<char*> pointers;
  pointers.reserve(words.size() + 1);
  for (std::string& word : words) pointers.push_back(word.data());
  pointers.push_back(nullptr);
  const absl::StatusOr<int> out = OpenLog(absl::StrCat(log_prefix, ".out"));
  if (!out.ok()) return out.status();
  const absl::StatusOr<int> err = OpenLog(absl::StrCat(log_prefix, ".err"));
  if (!err.ok()) {
    close(*out);
    return err.status();
  }
  const pid_t pid = fork();
  if (pid == 0) RunChild(pointers, *out, *err);
  close(*out);
  close(*err);
  CRAFTFLEET_CHECK(pid > 0);
  const int pid_descriptor = static_cast<int>(syscall(SYS_pidfd_open, pid, 0));
  CRAFTFLEET_CHECK(pid_descriptor >= 0);
  return std::unique_ptr<Process>(new Process(pid, pid_descriptor, log_prefix));
}

Process::Process(pid_t pid, int pid_descriptor, std::string log_prefix)
    : pid_(pid), pid_descriptor_(pid_descriptor), log_prefix_(std::move(log_prefix)) {}

Process::~Process() {
  const bool ended_unnoticed = !exit_code_.has_value() && WaitForEnd(absl::ZeroDuration());
  Kill();
  close(pid_descriptor_);
  if (ended_unnoticed) ReportCrash();
}

void Process::Signal(int signal) {
  if (!exit_code_.has_value()) kill(pid_, signal);
}

std::optional<int> Process::Wait(absl::Duration timeout) {
  if (exit_code_.has_value() || !WaitForEnd(timeout)) return exit_code_;
  int status = 0;
  CRAFTFLEET_CHECK(waitpid(pid_, &status, 0) == pid_);
  exit_code_ = WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
  return exit_code_;
}

void Process::Kill() {
  Signal(SIGKILL);
  Wait(absl::InfiniteDuration());
}

bool Process::WaitForText(absl::string_view text, absl::Duration timeout) const {
  const absl::Time deadline = absl::Now() + timeout;
  for (;;) {
    const bool last = WaitForEnd(absl::ZeroDuration()) || absl::Now() >= deadline;
    if (absl::StrContains(Out(), text) || absl::StrContains(Err(), text)) return true;
    if (last) return false;
    WaitForEnd(kLookInterval);
  }
}

absl::StatusOr<std::string> Process::WaitForAddress(absl::string_view before, absl::Duration timeout) const {
  const absl::Time deadline = absl::Now() + timeout;
  for (;;) {
    const bool last = WaitForEnd(absl::ZeroDuration()) || absl::Now() >= deadline;
    const std::string err = Err();
    const size_t start = absl::string_view(err).find(before);
    // Wait for a complete line: the address may be partly written.
    const size_t line_end = start == std::string::npos ? start : err.find('\n', start);
    if (line_end != std::string::npos) {
      const size_t word = start + before.size();
      return err.substr(word, std::min(err.find(' ', word), line_end) - word);
    }
    if (last) {
      return absl::DeadlineExceededError(
          absl::StrFormat("no \"%s\" in %s.err, which has:\n%s", before, log_prefix_, err));
    }
    WaitForEnd(kLookInterval);
  }
}

std::string Process::Out() const { return ReadFile(absl::StrCat(log_prefix_, ".out")).value_or(""); }

std::string Process::Err() const { return ReadFile(absl::StrCat(log_prefix_, ".err")).value_or(""); }

void Process::ReportCrash() const {
  const int code = exit_code_.value_or(0);
  const std::string err = Err();
  bool crashed = absl::StrContains(err, "Sanitizer: ") || absl::StrContains(err, ": runtime error: ");
  for (const int signal : {SIGSEGV, SIGABRT, SIGBUS, SIGFPE, SIGILL}) crashed |= code == 128 + signal;
  if (crashed) ADD_FAILURE() << log_prefix_ << ": a process ended by itself with " << code << ":\n" << err;
}

bool Process::WaitForEnd(absl::Duration timeout) const {
  if (exit_code_.has_value()) return true;
  const absl::Time deadline = absl::Now() + timeout;
  for (;;) {
    pollfd end = {pid_descriptor_, POLLIN, 0};
    const absl::Duration left = std::min(std::max(deadline - absl::Now(), absl::ZeroDuration()), absl::Hours(24));
    const int ready = poll(&end, 1, static_cast<int>(absl::ToInt64Milliseconds(left)));
    if (ready >= 0) return ready > 0;
    CRAFTFLEET_CHECK(errno == EINTR);
  }
}

}  // namespace craftfleet
