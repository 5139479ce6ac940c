// Simulates a disk whose sync fails and drops the unwritten data. As on Linux, the next sync of the same file succeeds,
// but the dropped data stays lost. Defines fsync for the program or library that includes this header; include it only
// once in each.

#pragma once

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <map>
#include <mutex>
#include <string>

namespace craftfleet {

// Thread-safe.
class DroppingDisk {
 public:
  static DroppingDisk& Get() {
    static auto* const disk = new DroppingDisk;  // never destroyed: files may be synced at exit
    return *disk;
  }
  // Makes the `nth` sync (from 1) of a path that ends in `ending` fail, counted from now.
  void FailSync(const std::string& ending, int nth) {
    const std::lock_guard<std::mutex> lock(mu_);
    ending_ = ending;
    left_ = nth;
  }
  // From now on the sync of a folder fails with EINVAL.
  void SyncNoFolders() {
    const std::lock_guard<std::mutex> lock(mu_);
    syncs_no_folders_ = true;
  }
  // Whether that sync has happened.
  bool failed() const {
    const std::lock_guard<std::mutex> lock(mu_);
    return left_ == 0;
  }

  int Sync(int descriptor) {
    const std::lock_guard<std::mutex> lock(mu_);
    const std::string path = PathOf(descriptor);
    const bool is_meant = left_ > 0 && path.size() >= ending_.size() &&
                          path.compare(path.size() - ending_.size(), ending_.size(), ending_) == 0;
    if (is_meant && --left_ == 0) {
      Drop(path, SizeOf(descriptor));
      errno = EIO;
      return -1;
    }
    if (syncs_no_folders_ && IsFolder(descriptor)) {
      errno = EINVAL;
      return -1;
    }
    const auto result = static_cast<int>(::syscall(SYS_fsync, descriptor));
    if (result == 0) synced_[path] = SizeOf(descriptor);
    return result;
  }

 private:
  static std::string PathOf(int descriptor) {
    char path[4096];
    const ssize_t size = ::readlink(("/proc/self/fd/" + std::to_string(descriptor)).c_str(), path, sizeof(path));
    return {path, size > 0 ? static_cast<size_t>(size) : 0};
  }
  static bool IsFolder(int descriptor) {
    struct stat status {};
    return ::fstat(descriptor, &status) == 0 && S_ISDIR(status.st_mode);
  }
  // Bytes in a regular file; 0 for folders, whose syncs drop nothing.
  static off_t SizeOf(int descriptor) {
    struct stat status {};
    return ::fstat(descriptor, &status) == 0 && S_ISREG(status.st_mode) ? status.st_size : 0;
  }
  void Drop(const std::string& path, off_t size) {
    const off_t begin = synced_[path];
    if (begin >= size) return;
    const std::string zeros(size - begin, '\0');
    const int descriptor = ::open(path.c_str(), O_WRONLY | O_CLOEXEC);
    if (::pwrite(descriptor, zeros.data(), zeros.size(), begin) < 0) ::_exit(99);  // the test cannot continue
    ::close(descriptor);
  }

  mutable std::mutex mu_;
  std::string ending_;
  int left_ = -1;
  bool syncs_no_folders_ = false;
  std::map<std::string, off_t> synced_;  // by path
};

}  // namespace craftfleet

extern "C" int fsync(int descriptor) { return craftfleet::DroppingDisk::Get().Sync(descriptor); }
