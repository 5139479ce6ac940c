#include "common/watched_file.h"

#include <sys/stat.h>

#include <absl/status/statusor.h>

#include "common/files.h"
#include "common/log.h"

namespace craftfleet {

std::optional<std::string> WatchedFile::ReadIfChanged() {
  const absl::Time now = clock_->Now();
  if (now - looked_ < absl::Seconds(1)) return std::nullopt;
  looked_ = now;
  // The stamp is taken before reading: a change in between is found by the next look.
  struct stat status = {};
  Stamp stamp;
  if (stat(path_.c_str(), &status) == 0) {
    stamp = {status.st_ino, absl::ToUnixNanos(absl::TimeFromTimespec(status.st_mtim)), status.st_size};
    if (stamp == stamp_) return std::nullopt;
  }
  absl::StatusOr<std::string> bytes = ReadFile(path_);
  if (!bytes.ok()) {
    if (!missing_) LogError("%s; what it said before stays in force until it is back", bytes.status().message());
    missing_ = true;
    return std::nullopt;
  }
  missing_ = false;
  stamp_ = stamp;
  return *std::move(bytes);
}

}  // namespace craftfleet
