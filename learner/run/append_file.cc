#include "learner/run/append_file.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#include <absl/strings/str_cat.h>

#include "common/files.h"

namespace craftfleet {

absl::StatusOr<AppendFile> AppendFile::Open(const std::string& path) {
  const int descriptor = ::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (descriptor < 0) return FileError(errno, "cannot open", path);
  const off_t length = ::lseek(descriptor, 0, SEEK_END);
  if (length < 0) {
    const absl::Status status = FileError(errno, "cannot seek in", path);
    ::close(descriptor);
    return status;
  }
  return AppendFile(path, descriptor, length);
}

AppendFile::AppendFile(AppendFile&& other) noexcept
    : path_(std::move(other.path_)),
      descriptor_(std::exchange(other.descriptor_, -1)),
      length_(other.length_),
      waiting_(std::move(other.waiting_)),
      torn_(other.torn_) {}

AppendFile::~AppendFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

absl::Status AppendFile::Flush() {
  if (torn_ && ::ftruncate(descriptor_, length_) != 0) return FileError(errno, "cannot cut back", path_);
  torn_ = false;
  if (waiting_.empty()) return absl::OkStatus();
  absl::Status status = WriteAll(descriptor_, waiting_, path_);
  if (status.ok()) {
    length_ += waiting_bytes();
    std::string().swap(waiting_);
  } else {
    torn_ = ::ftruncate(descriptor_, length_) != 0;
  }
  return status;
}

absl::Status AppendFile::Sync() {
  return ::fsync(descriptor_) == 0 ? absl::OkStatus() : FileError(errno, "cannot sync", path_);
}

absl::Status AppendFile::TruncateTo(int64_t length) {
  if (length > length_) {
    return absl::DataLossError(absl::StrCat(path_, " has ", length_, " bytes, the checkpoint saw ", length));
  }
  if (::ftruncate(descriptor_, length) != 0) return FileError(errno, "cannot cut back", path_);
  length_ = length;
  return absl::OkStatus();
}

}  // namespace craftfleet
