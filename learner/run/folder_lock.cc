#include "learner/run/folder_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <system_error>
#include <utility>

#include <absl/status/status.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/strip.h>

#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

// Whether this error of flock(2) means that the file system, or its server, offers no locks.
bool HasNoLocks(int error_number) {
  return error_number == ENOSYS || error_number == ENOLCK || error_number == EOPNOTSUPP || error_number == EINVAL;
}

}  // namespace

std::string ProcessName() {
  std::array<char, 256> host{};
  if (::gethostname(host.data(), host.size() - 1) != 0) host = {"?"};
  return absl::StrCat("process ", ::getpid(), " on ", host.data());
}

absl::StatusOr<FolderLock> FolderLock::Acquire(const std::string& folder) {
  const std::string path = JoinPath(folder, "lock");
  const int descriptor = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (descriptor < 0) return FileError(errno, "cannot open", path);
  FolderLock lock(descriptor);
  if (::flock(descriptor, LOCK_EX | LOCK_NB) != 0) {
    if (HasNoLocks(errno)) {
      LogWarning(
          "%s: the file system has no locks (%s); do not start a second process with this --logdir: it would take "
          "the run over",
          folder, std::generic_category().message(errno));
      return lock;
    }
    if (errno != EWOULDBLOCK) return FileError(errno, "cannot lock", path);
    const absl::StatusOr<std::string> holder = ReadFile(path);
    return absl::FailedPreconditionError(
        absl::StrCat("run folder ", folder, " is in use by ",
                     holder.ok() && !holder->empty() ? absl::StripSuffix(*holder, "\n") : "another process",
                     ": stop that process or use another --logdir"));
  }
  if (::ftruncate(descriptor, 0) != 0) return FileError(errno, "cannot truncate", path);
  CRAFTFLEET_RETURN_IF_ERROR(WriteAll(descriptor, absl::StrCat(ProcessName(), "\n"), path));
  return lock;
}

FolderLock::FolderLock(FolderLock&& other) noexcept : descriptor_(std::exchange(other.descriptor_, -1)) {}

FolderLock::~FolderLock() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

}  // namespace craftfleet
