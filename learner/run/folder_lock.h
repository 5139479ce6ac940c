// Prevents two processes from writing the same run folder. File: FORMATS.md, section 8.

#pragma once

#include <string>

#include <absl/status/statusor.h>

namespace craftfleet {

// Describes this process for people: "process 1234 on host".
std::string ProcessName();

// Holds a flock on <folder>/lock for its lifetime. The system releases it when the process ends for any reason.
class FolderLock {
 public:
  // Never waits.
  //   FailedPrecondition: another process holds the lock; names process and host.
  static absl::StatusOr<FolderLock> Acquire(const std::string& folder);
  FolderLock(FolderLock&& other) noexcept;
  FolderLock& operator=(FolderLock&& other) = delete;
  ~FolderLock();

 private:
  explicit FolderLock(int descriptor) : descriptor_(descriptor) {}
  int descriptor_;  // -1: moved from
};

}  // namespace craftfleet
