// A log that only grows, and can be cut back to a length it once had.
// Thread-compatible: one thread at a time.

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

  // Hands all of `bytes` to the system. On failure the file is as long as before.
  //   ResourceExhausted: disk, quota or file size limit full.
  absl::Status Append(absl::string_view bytes);

  // Makes all that was appended durable.
  absl::Status Sync();

  // Cuts the file to `length` bytes.
  //   DataLoss: it is shorter than that.
  absl::Status TruncateTo(int64_t length);

  int64_t length() const { return length_; }  // bytes
  const std::string& path() const { return path_; }

 private:
  AppendFile(std::string path, int descriptor, int64_t length)
      : path_(std::move(path)), descriptor_(descriptor), length_(length) {}

  std::string path_;
  int descriptor_;  // -1: moved from
  int64_t length_;
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_APPEND_FILE_H_
