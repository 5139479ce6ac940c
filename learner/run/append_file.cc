#include "learner/run/append_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>

#include <absl/strings/str_cat.h>

#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/telemetry/log.h"

namespace craftfleet {
namespace {

constexpr size_t kMaxUnsyncedBytes = 1 << 20;

// Whether `path` no longer leads to the open file. False if the disk can't tell.
bool WasReplaced(int descriptor, const std::string& path) {
  struct stat opened = {};
  struct stat named = {};
  if (::stat(path.c_str(), &named) != 0) return errno == ENOENT;
  return ::fstat(descriptor, &opened) == 0 && (opened.st_dev != named.st_dev || opened.st_ino != named.st_ino);
}

// A log is the only file of a run that is changed in place: one with further names, as after `cp -al`, would change
// for the run that it was copied from too.
absl::Status EndHardLinks(const std::string& path) {
  struct stat file = {};
  if (::lstat(path.c_str(), &file) != 0 || !S_ISREG(file.st_mode) || file.st_nlink == 1) return absl::OkStatus();
  CRAFTFLEET_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(path));
  return ReplaceFile(path, bytes);
}

}  // namespace

absl::StatusOr<AppendFile> AppendFile::Open(const std::string& path, const EpochFence* fence) {
  AppendFile file(path, fence);
  CRAFTFLEET_RETURN_IF_ERROR(EndHardLinks(path));
  CRAFTFLEET_RETURN_IF_ERROR(file.OpenDescriptor());
  CRAFTFLEET_ASSIGN_OR_RETURN(file.length_, file.FindEnd());
  return file;
}

AppendFile::AppendFile(AppendFile&& other) noexcept
    : path_(std::move(other.path_)),
      fence_(other.fence_),
      descriptor_(std::exchange(other.descriptor_, -1)),
      length_(other.length_),
      unsynced_(std::move(other.unsynced_)),
      waiting_(std::move(other.waiting_)),
      torn_(other.torn_) {}

AppendFile::~AppendFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

absl::Status AppendFile::OpenDescriptor() {
  descriptor_ = ::open(path_.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  return descriptor_ >= 0 ? absl::OkStatus() : FileError(errno, "cannot open", path_);
}

absl::StatusOr<int64_t> AppendFile::FindEnd() const {
  const off_t end = ::lseek(descriptor_, 0, SEEK_END);
  if (end < 0) return FileError(errno, "cannot seek in", path_);
  return end;
}

absl::Status AppendFile::CheckFence() const { return fence_ != nullptr ? fence_->Check() : absl::OkStatus(); }

absl::Status AppendFile::Prepare() {
  if (descriptor_ < 0 || WasReplaced(descriptor_, path_)) {
    CRAFTFLEET_RETURN_IF_ERROR(CheckFence());
    if (descriptor_ >= 0) {
      LogError("%s was replaced or removed by something else; the run goes on in the file of that name", path_);
      ::close(std::exchange(descriptor_, -1));
    }
    CRAFTFLEET_RETURN_IF_ERROR(OpenDescriptor());
  }
  // Seen before the fence is checked, so that these bytes are not those of a later start.
  CRAFTFLEET_ASSIGN_OR_RETURN(const int64_t end, FindEnd());
  CRAFTFLEET_RETURN_IF_ERROR(CheckFence());
  if (end > length_ && ::ftruncate(descriptor_, length_) != 0) return FileError(errno, "cannot truncate", path_);
  if (end < length_) {
    LogError(
        "%s has %d bytes, want the %d that were written: something else has cut it, and the run goes on without "
        "what is missing; checkpoints from before cannot be resumed from until a whole copy of it is put back",
        path_, end, length_);
    Shorten(end);
  }
  torn_ = false;
  return absl::OkStatus();
}

absl::Status AppendFile::Flush() {
  if (waiting_.empty() && !torn_) return absl::OkStatus();
  CRAFTFLEET_RETURN_IF_ERROR(Prepare());
  absl::Status status = WriteAll(descriptor_, waiting_, path_);
  if (!status.ok()) {
    torn_ = ::ftruncate(descriptor_, length_) != 0;
    return status;
  }
  length_ += waiting_bytes();
  unsynced_ += waiting_;
  std::string().swap(waiting_);
  return unsynced_.size() > kMaxUnsyncedBytes ? Sync() : absl::OkStatus();
}

absl::Status AppendFile::Sync() {
  CRAFTFLEET_RETURN_IF_ERROR(Prepare());
  if (SyncDescriptor(descriptor_) == 0) {
    std::string().swap(unsynced_);
    return absl::OkStatus();
  }
  absl::Status status = FileError(errno, "cannot sync", path_);
  ::close(descriptor_);
  descriptor_ = -1;
  length_ -= static_cast<int64_t>(unsynced_.size());
  torn_ = true;
  waiting_.insert(0, unsynced_);
  unsynced_.clear();
  return status;
}

absl::Status AppendFile::TruncateTo(int64_t length) {
  if (length > length_) {
    return absl::DataLossError(absl::StrCat(path_, " has ", length_, " bytes, but the checkpoint expects ", length));
  }
  CRAFTFLEET_RETURN_IF_ERROR(Prepare());
  if (::ftruncate(descriptor_, length) != 0) return FileError(errno, "cannot truncate", path_);
  Shorten(length);
  return absl::OkStatus();
}

void AppendFile::Shorten(int64_t length) {
  const int64_t synced = length_ - static_cast<int64_t>(unsynced_.size());
  unsynced_.resize(length > synced ? length - synced : 0);
  length_ = length;
}

}  // namespace craftfleet
