#include "common/io/files.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <filesystem>
#include <system_error>

#include <absl/cleanup/cleanup.h>
#include <absl/strings/match.h>
#include <absl/strings/str_cat.h>
#include <absl/strings/strip.h>

#include "common/base/status_macros.h"

namespace craftfleet {
namespace {

namespace fs = std::filesystem;

// Tries. Each removes the files that were added during the one before.
constexpr int kRemovals = 100;
constexpr absl::string_view kUnfinishedPrefix = ".craftfleet-";
constexpr absl::string_view kUnfinishedEnding = ".tmp";

std::string ParentOf(const std::string& path) {
  const fs::path parent = fs::path(path).parent_path();
  return parent.empty() ? "." : parent.string();
}

// Writes all of `bytes`, syncs and closes. `path` is for the message only.
absl::Status WriteAndClose(int descriptor, absl::string_view bytes, const std::string& path) {
  absl::Status status = WriteAll(descriptor, bytes, path);
  if (status.ok() && SyncDescriptor(descriptor) != 0) status = FileError(errno, "cannot sync", path);
  // Network file systems report a full disk only here.
  if (::close(descriptor) != 0 && status.ok()) status = FileError(errno, "cannot close", path);
  return status;
}

}  // namespace

absl::Status FileError(int error_number, absl::string_view what, absl::string_view path) {
  // Not absl::ErrnoToStatus: the table of texts in the packaged library looks like a race to ThreadSanitizer.
  const std::string message = absl::StrCat(what, " ", path, ": ", std::generic_category().message(error_number));
  const bool full = error_number == ENOSPC || error_number == EDQUOT || error_number == EFBIG;
  return full ? absl::ResourceExhaustedError(message) : absl::Status(absl::ErrnoToStatusCode(error_number), message);
}

std::string JoinPath(absl::string_view folder, absl::string_view name) {
  return absl::StrCat(absl::StripSuffix(folder, "/"), "/", name);
}

bool PathExists(const std::string& path) {
  std::error_code error;
  return fs::exists(path, error);
}

absl::StatusOr<std::string> ReadFile(const std::string& path) {
  const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) return FileError(errno, "cannot open", path);
  const absl::Cleanup close = [descriptor] { ::close(descriptor); };
  std::string bytes;
  constexpr size_t kChunk = 1 << 20;
  while (true) {
    const size_t size = bytes.size();
    bytes.resize(size + kChunk);
    const ssize_t got = ::read(descriptor, &bytes[size], kChunk);
    const int error_number = errno;
    bytes.resize(size + (got > 0 ? got : 0));
    if (got == 0) return bytes;
    if (got < 0 && error_number != EINTR) return FileError(error_number, "cannot read", path);
  }
}

absl::StatusOr<int64_t> FileSize(const std::string& path) {
  std::error_code error;
  const std::uintmax_t size = fs::file_size(path, error);
  if (error) return FileError(error.value(), "cannot get the size of", path);
  return static_cast<int64_t>(size);
}

absl::Status WriteAll(int descriptor, absl::string_view bytes, absl::string_view path) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(descriptor, bytes.data(), bytes.size());
    if (written >= 0) {
      bytes.remove_prefix(written);
    } else if (errno != EINTR) {
      return FileError(errno, "cannot write", path);
    }
  }
  return absl::OkStatus();
}

int SyncDescriptor(int descriptor) {
  if (::fsync(descriptor) == 0) return 0;
  return errno == EINVAL || errno == ENOSYS || errno == EOPNOTSUPP || errno == EBADF || errno == EISDIR ? 0 : -1;
}

absl::Status WriteFileSynced(const std::string& path, absl::string_view bytes) {
  const int descriptor = ::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (descriptor < 0) return FileError(errno, "cannot create", path);
  return WriteAndClose(descriptor, bytes, path);
}

absl::StatusOr<std::string> CreateBeside(const std::string& path, absl::string_view ending) {
  static std::atomic<int> number{0};
  while (true) {
    std::string name = JoinPath(ParentOf(path), absl::StrCat(kUnfinishedPrefix, ::getpid(), "-", ++number, ending));
    const int descriptor = ::open(name.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
    if (descriptor < 0 && errno == EEXIST) continue;
    if (descriptor < 0) return FileError(errno, "cannot create", path);
    ::close(descriptor);
    return name;
  }
}

absl::Status ReplaceFile(const std::string& path, absl::string_view bytes) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string temporary, CreateBeside(path, kUnfinishedEnding));
  const int descriptor = ::open(temporary.c_str(), O_WRONLY | O_CLOEXEC);
  struct stat old = {};
  if (descriptor >= 0 && ::stat(path.c_str(), &old) == 0) ::fchmod(descriptor, old.st_mode & 07777);
  absl::Status status =
      descriptor < 0 ? FileError(errno, "cannot open", temporary) : WriteAndClose(descriptor, bytes, path);
  if (status.ok()) status = RenameSynced(temporary, path);
  if (!status.ok()) ::unlink(temporary.c_str());
  return status;
}

absl::Status RemoveUnfinished(const std::string& folder) {
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::vector<std::string> names, ListFolder(folder));
  absl::Status status;
  for (const std::string& name : names) {
    const bool is_unfinished = absl::StartsWith(name, kUnfinishedPrefix) && absl::EndsWith(name, kUnfinishedEnding);
    if (is_unfinished) status.Update(RemoveAll(JoinPath(folder, name)));
  }
  return status;
}

absl::Status SyncFolder(const std::string& folder) {
  const int descriptor = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (descriptor < 0 && errno == EACCES) return absl::OkStatus();  // one that may only be written, mode -wx
  if (descriptor < 0) return FileError(errno, "cannot open", folder);
  const absl::Cleanup close = [descriptor] { ::close(descriptor); };
  return SyncDescriptor(descriptor) == 0 ? absl::OkStatus() : FileError(errno, "cannot sync", folder);
}

absl::Status CreateFolders(const std::string& path) {
  std::error_code error;
  fs::create_directories(path, error);
  return error ? FileError(error.value(), "cannot create folder", path) : absl::OkStatus();
}

absl::Status RenameSynced(const std::string& from, const std::string& to) {
  if (::rename(from.c_str(), to.c_str()) != 0) return FileError(errno, absl::StrCat("cannot rename ", from, " to"), to);
  return SyncFolder(ParentOf(to));
}

absl::Status RemoveAll(const std::string& path) {
  std::error_code error;
  int tries = kRemovals;
  do {
    fs::remove_all(path, error);
  } while (error == std::errc::directory_not_empty && --tries > 0);
  return error ? FileError(error.value(), "cannot remove", path) : absl::OkStatus();
}

absl::StatusOr<std::vector<std::string>> ListFolder(const std::string& folder) {
  std::error_code error;
  std::vector<std::string> names;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error)) {
    names.push_back(it->path().filename().string());
  }
  if (error) return FileError(error.value(), "cannot list", folder);
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace craftfleet
