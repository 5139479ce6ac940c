#include "common/io/output_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <system_error>
#include <utility>

#include <absl/strings/numbers.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/strip.h>

#include "common/base/status_macros.h"
#include "common/base/status_prefix.h"
#include "common/io/files.h"

namespace craftfleet {
namespace {

namespace fs = std::filesystem;

// The open descriptor of this process that `path` names; nullopt for other paths. Opening such a path again would yield
// a descriptor at offset 0, which overwrites what was printed.
std::optional<int> DescriptorOf(absl::string_view path) {
  if (path == "-" || path == "/dev/stdout") return STDOUT_FILENO;
  if (path == "/dev/stderr") return STDERR_FILENO;
  int number = 0;
  const bool names_one = absl::ConsumePrefix(&path, "/dev/fd/") || absl::ConsumePrefix(&path, "/proc/self/fd/");
  return names_one && absl::SimpleAtoi(path, &number) ? std::optional<int>(number) : std::nullopt;
}

bool IsOpenAt(const struct stat& file, int descriptor) {
  struct stat open = {};
  return fstat(descriptor, &open) == 0 && open.st_dev == file.st_dev && open.st_ino == file.st_ino;
}

// The status of `path`, without following links; nullopt if it does not exist.
absl::StatusOr<std::optional<struct stat>> Look(const std::string& path) {
  struct stat file = {};
  if (stat(path.c_str(), &file) == 0) return file;
  if (errno == ENOENT) return std::nullopt;
  return FileError(errno, "cannot access", path);
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
  OutputFile file(flag, path);
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
  if (DescriptorOf(path_).has_value()) return OpenStream();
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::optional<struct stat> file, Look(path_));
  if (!file.has_value()) return TryFile();
  switch (file->st_mode & S_IFMT) {
    case S_IFREG:
      // As in `--out=a.png > a.png`: a renamed file would not be the one that standard output writes to.
      if (IsOpenAt(*file, STDOUT_FILENO)) return OpenStream();
      // A rename would succeed, but a read-only file is meant to be kept.
      if (::access(path_.c_str(), W_OK) != 0) return FileError(errno, "cannot write", path_);
      return TryFile();
    case S_IFIFO:
    case S_IFCHR:
      return OpenStream();
    case S_IFDIR:
      return absl::InvalidArgumentError(absl::StrCat(path_, " is a folder, want a file"));
    default:
      return absl::InvalidArgumentError(absl::StrCat(path_, " is a block device or a socket, want a file or a stream"));
  }
}

absl::Status OutputFile::OpenStream() {
  std::optional<int> descriptor = DescriptorOf(path_);
  struct stat file = {};
  if (!descriptor.has_value() && stat(path_.c_str(), &file) == 0 && IsOpenAt(file, STDOUT_FILENO) &&
      !S_ISCHR(file.st_mode)) {
    descriptor = STDOUT_FILENO;
  }
  standard_output_ = descriptor == STDOUT_FILENO;
  stream_ = descriptor.has_value() ? ::fcntl(*descriptor, F_DUPFD_CLOEXEC, 0)
                                   : ::open(path_.c_str(), O_WRONLY | O_NOCTTY | O_CLOEXEC);
  if (standard_output_) path_ = "standard output";
  if (stream_ < 0) return FileError(errno, "cannot open", path_);
  const int flags = ::fcntl(stream_, F_GETFL);
  return flags >= 0 && (flags & O_ACCMODE) == O_RDONLY ? FileError(EBADF, "cannot write", path_) : absl::OkStatus();
}

// A regular file is written under a temporary name and renamed. Checks now that this is possible.
absl::Status OutputFile::TryFile() {
  CRAFTFLEET_ASSIGN_OR_RETURN(path_, FollowLinks(path_));
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string probe, CreateBeside(path_));
  ::unlink(probe.c_str());
  return absl::OkStatus();
}

absl::Status OutputFile::Write(absl::string_view bytes) {
  if (stream_ < 0) return Named(ReplaceFile(path_, bytes));
  if (standard_output_ && std::fflush(stdout) != 0) return Named(FileError(errno, "cannot write", path_));
  absl::Status status = WriteAll(stream_, bytes, path_);
  if (::close(std::exchange(stream_, -1)) != 0 && status.ok()) status = FileError(errno, "cannot close", path_);
  return Named(status);
}

absl::Status OutputFile::Named(const absl::Status& status) const { return WithPrefix(flag_, status); }

}  // namespace craftfleet
