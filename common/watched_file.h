// A file that its owner may replace while the program runs.

#ifndef CRAFTFLEET_COMMON_WATCHED_FILE_H_
#define CRAFTFLEET_COMMON_WATCHED_FILE_H_

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <string>

#include <absl/time/time.h>

#include "common/clock.h"

namespace craftfleet {

// Looks at the file at most once a second. Thread-compatible.
class WatchedFile {
 public:
  // `clock` outlives the object.
  WatchedFile(std::string path, Clock* clock) : path_(std::move(path)), clock_(clock) {}

  // The file's contents if they may differ from those of the last call that returned any. Nothing: it is as it was, or
  // it can't be read, which is logged once.
  std::optional<std::string> ReadIfChanged();

  const std::string& path() const { return path_; }

 private:
  struct Stamp {
    ino_t inode = 0;
    int64_t modified_ns = -1;
    off_t size = 0;
    friend bool operator==(const Stamp& a, const Stamp& b) {
      return a.inode == b.inode && a.modified_ns == b.modified_ns && a.size == b.size;
    }
  };

  const std::string path_;
  Clock* const clock_;
  absl::Time looked_ = absl::InfinitePast();
  Stamp stamp_;
  bool missing_ = false;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_WATCHED_FILE_H_
