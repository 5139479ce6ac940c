// A file that its owner may replace while the program runs.

#ifndef CRAFTFLEET_COMMON_WATCHED_FILE_H_
#define CRAFTFLEET_COMMON_WATCHED_FILE_H_

#include <sys/types.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <absl/time/time.h>

namespace craftfleet {

// Looks at the file when asked. Thread-compatible.
class WatchedFile {
 public:
  explicit WatchedFile(std::string path) : path_(std::move(path)) {}

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
  Stamp stamp_;
  bool missing_ = false;
};

// Looks at a file every second on a thread of its own, so that a disk that hangs makes nobody wait. Thread-safe.
class FileWatch {
 public:
  // `changed` gets the contents whenever they differ from those before, `contents` at first. It is called on the
  // watch's thread, which may outlive the watch: it must own what it uses.
  FileWatch(const std::string& path, std::string contents, std::function<void(std::string)> changed);
  // Waits for the thread for at most 0.2 s: one that hangs in a read is left alone.
  ~FileWatch();
  FileWatch(const FileWatch&) = delete;
  FileWatch& operator=(const FileWatch&) = delete;

 private:
  struct State;
  const std::shared_ptr<State> state_;  // shared with the thread
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_COMMON_WATCHED_FILE_H_
