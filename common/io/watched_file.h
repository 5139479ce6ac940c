// A file that may be replaced while the program runs.

#pragma once

#include <sys/types.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include <absl/time/time.h>

namespace craftfleet {

// Checks the file when it is called. Thread-compatible.
class WatchedFile {
 public:
  explicit WatchedFile(std::string path) : path_(std::move(path)) {}

  // The file's contents if they may have changed since the last call that returned any. nullopt: unchanged, or the file
  // cannot be read, which is logged once.
  std::optional<std::string> ReadIfChanged();

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

// Checks a file every second on a thread of its own, so that no caller waits for a hanging disk. Thread-safe.
class FileWatch {
 public:
  // Calls `changed` with the contents whenever they differ from the previous ones, `contents` at first. It is called on
  // the watch's thread, which may outlive the watch: it must own what it uses.
  FileWatch(const std::string& path, std::string contents, std::function<void(std::string)> changed);
  // Waits at most 0.2 s for the thread: if it hangs in a read, it is left running.
  ~FileWatch();
  FileWatch(const FileWatch&) = delete;
  FileWatch& operator=(const FileWatch&) = delete;

 private:
  struct State;
  const std::shared_ptr<State> state_;  // shared with the thread
};

}  // namespace craftfleet
