#include "deploy/cli/sweep/child_process.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>

#include "common/base/check.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

int SpawnInOwnGroup(const std::string& program, char* const* arguments, const std::string& log, pid_t* pid) {
  posix_spawn_file_actions_t files;
  posix_spawnattr_t attributes;
  sigset_t no_signals;
  sigemptyset(&no_signals);
  CRAFTFLEET_CHECK(posix_spawn_file_actions_init(&files) == 0 && posix_spawnattr_init(&attributes) == 0);
  posix_spawn_file_actions_addopen(&files, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(&files, STDOUT_FILENO, log.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0644);
  posix_spawn_file_actions_adddup2(&files, STDOUT_FILENO, STDERR_FILENO);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGMASK);
  posix_spawnattr_setpgroup(&attributes, 0);
  posix_spawnattr_setsigmask(&attributes, &no_signals);
  const int error = posix_spawn(pid, program.c_str(), &files, &attributes, arguments, environ);
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&files);
  return error;
}

}  // namespace

absl::StatusOr<std::unique_ptr<ChildProcess>> ChildProcess::Start(const std::string& program,
                                                                  const std::vector<std::string>& arguments,
                                                                  const std::string& log) {
  std::vector<std::string> words = {program};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> pointers;
  pointers.reserve(words.size() + 1);
  for (std::string& word : words) pointers.push_back(word.data());
  pointers.push_back(nullptr);
  pid_t pid = 0;
  const int error = SpawnInOwnGroup(program, pointers.data(), log, &pid);
  if (error != 0) return FileError(error, "cannot start", program);
  return std::unique_ptr<ChildProcess>(new ChildProcess(pid));
}

int ChildProcess::Wait() {
  // The child is not reaped yet, so that Terminate() never signals a process that reuses its id.
  siginfo_t info;
  while (waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOWAIT) != 0) CRAFTFLEET_CHECK(errno == EINTR);
  MutexLock lock(&mu_);
  ended_ = true;
  int status = 0;
  while (waitpid(pid_, &status, 0) < 0) CRAFTFLEET_CHECK(errno == EINTR);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

void ChildProcess::Terminate() {
  MutexLock lock(&mu_);
  if (!ended_) kill(pid_, SIGTERM);
}

}  // namespace craftfleet
