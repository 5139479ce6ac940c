#include "common/io/output_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <system_error>
#include <utility>

#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/string_view.h>

#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

namespace fs = std::filesystem;

// Whether `path` names an open descriptor of this process. If that is a file, it must not be replaced.
bool NamesDescriptor(absl::string_view path) {
  return path == "/dev/stdout" || path == "/dev/stderr" || absl::StartsWith(path, "/dev/fd/") ||
         absl::StartsWith(path, "/proc/self/fd/");
}

bool IsStandardOutput(const struct stat& file) {
  struct stat output = {};
  return fstat(STDOUT_FILENO, &output) == 0 && output.st_dev == file.st_dev && output.st_ino == file.st_ino;
}

// `path` with links in its last component followed, including a link to a file that does not exist yet.
absl::StatusOr<std::string> FollowLinks(const std::string& path) {
  constexpr int kMostLinks = 40;  // as Linux
  fs::path target = path;
  for (int i = 0; i < kMostLinks; ++i) {
    std::error_code error;
    const fs::path link = fs::read_symlink(target, error);
    if (error) return target.string();
    target = link.is_absolute() ? link : target.parent_path() / link;
  }
  return FileError(ELOOP, "cannot follow", path);
}

}  // namespace

absl::StatusOr<OutputFile> OutputFile::Open(absl::string_view flag, const std::string& path) {
  OutputFile file(flag, path == "-" ? "/dev/stdout" : path);
  CRAFTFLEET_RETURN_IF_ERROR(file.Named(file.OpenTarget()));
  return file;
}

OutputFile::OutputFile(OutputFile&& other) noexcept
    : flag_(std::move(other.flag_)),
      path_(std::move(other.path_)),
      stream_(std::exchange(other.stream_, -1)),
      standard_output_(other.standard_output_) {}

OutputFile::~OutputFile() {
  if (stream_ >= 0) ::close(stream_);
}

absl::Status OutputFile::OpenTarget() {
  struct stat file = {};
  if (stat(path_.c_str(), &file) != 0) return errno == ENOENT ? TryFile() : FileError(errno, "cannot access", path_);
  if (S_ISDIR(file.st_mode)) return absl::InvalidArgumentError(absl::StrCat(path_, " is a folder, want a file"));
  if (S_ISBLK(file.st_mode) || S_ISSOCK(file.st_mode)) {
    return absl::InvalidArgumentError(absl::StrCat(path_, " is a block device or a socket, want a file or a stream"));
  }
  // Also as in `--out=a.png > a.png`: a renamed file would not be the one that standard output writes to.
  const bool named = NamesDescriptor(path_);
  standard_output_ = (named || !S_ISCHR(file.st_mode)) && IsStandardOutput(file);
  if (S_ISREG(file.st_mode) && !named && !standard_output_) {
    // A rename would succeed, but a read-only file is meant to be kept.
    return ::access(path_.c_str(), W_OK) == 0 ? TryFile() : FileError(errno, "cannot write", path_);
  }
  stream_ = standard_output_ ? ::fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, 0)
                             : ::open(path_.c_str(), O_WRONLY | O_APPEND | O_NOCTTY | O_CLOEXEC);
  if (standard_output_) path_ = "standard output";
  return stream_ < 0 ? FileError(errno, "cannot open", path_) : absl::OkStatus();
}

// A regular file is written under a temporary name and renamed. Checks now that this is possible.
absl::Status OutputFile::TryFile() {
  CRAFTFLEET_ASSIGN_OR_RETURN(path_, FollowLinks(path_));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string probe, CreateBeside(path_));
  ::unlink(probe.c_str());
  return absl::OkStatus();
}

absl::Status OutputFile::Write(absl::string_view bytes) {
  if (stream_ < 0) {
    const absl::Status status = ReplaceFile(path_, bytes);
    // No file may be renamed to a mounted one (EBUSY), or to another user's in a folder like /tmp (EPERM).
    if (!absl::IsFailedPrecondition(status) && !absl::IsPermissionDenied(status)) return Named(status);
    stream_ = ::open(path_.c_str(), O_WRONLY | O_TRUNC | O_NOFOLLOW | O_CLOEXEC);
    if (stream_ < 0) return Named(status);
  }
  if (standard_output_ && std::fflush(stdout) != 0) return Named(FileError(errno, "cannot write", path_));
  absl::Status status = WriteAll(stream_, bytes, path_);
  if (::close(std::exchange(stream_, -1)) != 0 && status.ok()) status = FileError(errno, "cannot close", path_);
  return Named(status);
}

absl::Status OutputFile::Named(const absl::Status& status) const { return WithPrefix(flag_, status); }

}  // namespace craftfleet
