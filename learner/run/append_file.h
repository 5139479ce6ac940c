// A log that only grows, and can be cut back to a length it once had. What a full disk does not take waits in memory,
// in order, until there is room. Thread-compatible: one thread at a time.

#ifndef CRAFTFLEET_LEARNER_RUN_APPEND_FILE_H_
#define CRAFTFLEET_LEARNER_RUN_APPEND_FILE_H_

#include <cstdint>
#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

class AppendFile {
 public:
  // Creates `path` if it is not there.
  static absl::StatusOr<AppendFile> Open(const std::string& path);
  AppendFile(AppendFile&& other) noexcept;
  AppendFile& operator=(AppendFile&& other) = delete;
  ~AppendFile();

  // Puts `bytes` behind all that was appended before; Flush writes them.
  void Append(absl::string_view bytes) { waiting_.append(bytes.data(), bytes.size()); }
  // Hands all that waits to the system. On failure the file is as long as before, and all of it waits on.
  //   ResourceExhausted: disk, quota or file size limit full.
  absl::Status Flush();
  // Forgets what waits.
  void DropWaiting() { waiting_.clear(); }

  // Makes all that was flushed durable.
  absl::Status Sync();

  // Cuts the file, of which nothing waits, to `length` bytes.
  //   DataLoss: it is shorter than that.
  absl::Status TruncateTo(int64_t length);

  int64_t length() const { return length_; }  // bytes in the file
  int64_t waiting_bytes() const { return static_cast<int64_t>(waiting_.size()); }
  const std::string& path() const { return path_; }

 private:
  AppendFile(std::string path, int descriptor, int64_t length)
      : path_(std::move(path)), descriptor_(descriptor), length_(length) {}

  std::string path_;
  int descriptor_;  // -1: moved from
  int64_t length_;
  std::string waiting_;
  bool torn_ = false;  // a part of what waits is in the file and could not be cut off again
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_APPEND_FILE_H_
