// Keeps two processes from writing one run folder.

#ifndef CRAFTFLEET_LEARNER_RUN_FOLDER_LOCK_H_
#define CRAFTFLEET_LEARNER_RUN_FOLDER_LOCK_H_

#include <string>

#include <absl/status/statusor.h>

namespace craftfleet {

// "process 1234 on host": this one, for people.
std::string ProcessName();

// Holds <folder>/lock by flock for its lifetime; the system lets go when the process dies, however it dies.
class FolderLock {
 public:
  // Does not wait.
  //   FailedPrecondition: another one holds it; names process and host.
  static absl::StatusOr<FolderLock> Acquire(const std::string& folder);
  FolderLock(FolderLock&& other) noexcept;
  FolderLock& operator=(FolderLock&& other) = delete;
  ~FolderLock();

 private:
  explicit FolderLock(int descriptor) : descriptor_(descriptor) {}
  int descriptor_;  // -1: moved from
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_FOLDER_LOCK_H_
