#include "common/wire/certificate_copies.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <array>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/str_cat.h>
#include <absl/time/clock.h>

#include "common/base/mutex.h"
#include "common/base/status_macros.h"
#include "common/io/files.h"
#include "common/io/watched_file.h"
#include "common/telemetry/log.h"
#include "common/wire/certificates.h"

namespace craftfleet::wire {
namespace {

constexpr absl::Duration kLookEvery = absl::Seconds(1);
constexpr size_t kFiles = 3;

using Paths = std::array<std::string, kFiles>;     // certificate, key, authorities; empty: none
using Contents = std::array<std::string, kFiles>;  // of these

absl::Status Check(const Paths& paths, const Contents& contents) {
  if (!paths[0].empty()) CRAFTFLEET_RETURN_IF_ERROR(CheckKeyPair(paths[0], contents[0], paths[1], contents[1]));
  return paths[2].empty() ? absl::OkStatus() : CheckAuthorities(paths[2], contents[2]);
}

// A descriptor of a new file in memory; -1: failed.
int MakeFile(const std::string& contents) {
  const int file = memfd_create("craftfleet-certificate", MFD_CLOEXEC);
  if (file < 0) return -1;
  for (size_t written = 0; written < contents.size();) {
    const ssize_t count = write(file, contents.data() + written, contents.size() - written);
    if (count <= 0) {
      close(file);
      return -1;
    }
    written += static_cast<size_t>(count);
  }
  return file;
}

// Thread-safe.
class Copies {
 public:
  explicit Copies(Paths paths) : paths_(std::move(paths)) {
    for (const std::string& path : paths_) files_.emplace_back(path);
  }

  // Whether the files could be read, are valid and were copied.
  bool Begin() ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    for (size_t i = 0; i < kFiles; ++i) {
      if (paths_[i].empty()) continue;
      std::optional<std::string> contents = files_[i].ReadIfChanged();
      if (!contents.has_value()) return false;
      contents_[i] = *std::move(contents);
    }
    if (!Check(paths_, contents_).ok()) return false;
    for (size_t i = 0; i < kFiles; ++i) {
      if (paths_[i].empty()) continue;
      descriptors_[i] = MakeFile(contents_[i]);
      copies_[i] = absl::StrCat("/proc/self/fd/", descriptors_[i]);
      if (descriptors_[i] < 0 || access(copies_[i].c_str(), R_OK) != 0) return false;
    }
    return true;
  }

  // Of the copies. Constant after Begin.
  TlsFiles files() const { return {copies_[0], copies_[1], copies_[2]}; }

  // Copies the files if they have changed and are valid.
  void Look() ABSL_LOCKS_EXCLUDED(mu_) {
    const MutexLock lock(&mu_);
    for (size_t i = 0; i < kFiles; ++i) {
      if (paths_[i].empty()) continue;
      std::optional<std::string> contents = files_[i].ReadIfChanged();
      if (!contents.has_value() || *contents == contents_[i]) continue;
      contents_[i] = *std::move(contents);
      looks_ = 1;
    }
    if (looks_ == 0) return;
    if (const absl::Status valid = Check(paths_, contents_); !valid.ok()) {
      // Not at the first look, which may fall between the replacement of two files.
      if (looks_++ == 2) LogError("%s; the former certificates remain in use", valid.message());
      return;
    }
    looks_ = 0;
    for (size_t i = 0; i < kFiles; ++i) {
      if (!paths_[i].empty()) Replace(i);
    }
  }

 private:
  // At once: a reader gets the old file or the new one.
  void Replace(size_t i) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    const int file = MakeFile(contents_[i]);
    if (file < 0) return LogError("%s cannot be copied; the former certificates remain in use", paths_[i]);
    dup3(file, descriptors_[i], O_CLOEXEC);
    close(file);
  }

  const Paths paths_;
  Paths copies_;
  Mutex mu_;
  std::vector<WatchedFile> files_ ABSL_GUARDED_BY(mu_);
  Contents contents_ ABSL_GUARDED_BY(mu_);                                   // as last read
  std::array<int, kFiles> descriptors_ ABSL_GUARDED_BY(mu_) = {-1, -1, -1};  // of the copies
  int looks_ ABSL_GUARDED_BY(mu_) = 0;                                       // at contents that are not copied yet
};

}  // namespace

TlsFiles CopiesInMemory(const TlsFiles& files) {
  static auto* const mu = new Mutex;
  static auto* const all = new std::map<Paths, Copies*>;
  const Paths paths = {files.certificate, files.key, files.authorities};
  const MutexLock lock(mu);
  if (const auto found = all->find(paths); found != all->end()) {
    found->second->Look();
    return found->second->files();
  }
  auto made = std::make_unique<Copies>(paths);
  if (!made->Begin()) return files;
  Copies* const copies = made.release();
  all->emplace(paths, copies);
  std::thread([copies] {
    while (true) {
      absl::SleepFor(kLookEvery);
      copies->Look();
    }
  }).detach();
  return copies->files();
}

}  // namespace craftfleet::wire
