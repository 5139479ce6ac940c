// A log that only grows, and can be cut back to a length it once had. What a full disk does not take waits in memory,
// in order, until there is room; what a failed sync may have lost is written again. Thread-compatible: one thread at a
// time.

#ifndef CRAFTFLEET_LEARNER_RUN_APPEND_FILE_H_
#define CRAFTFLEET_LEARNER_RUN_APPEND_FILE_H_

#include <cstdint>
#include <string>
#include <utility>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

#include "learner/run/epoch.h"

namespace craftfleet {

class AppendFile {
 public:
  struct Options {
    // Asked before the file is changed; outlives this. Null: anyone may.
    const EpochFence* fence = nullptr;
    // Sync is used: what was written since the last time is kept in memory, 1 MiB at most.
    bool durable = true;
  };

  // Creates `path` if it is not there.
  static absl::StatusOr<AppendFile> Open(const std::string& path, const Options& options);
  static absl::StatusOr<AppendFile> Open(const std::string& path) { return Open(path, Options()); }
  AppendFile(AppendFile&& other) noexcept;
  AppendFile& operator=(AppendFile&& other) = delete;
  ~AppendFile();

  // Puts `bytes` behind all that was appended before; Flush writes them.
  void Append(absl::string_view bytes) { waiting_.append(bytes.data(), bytes.size()); }
  // Hands all that waits to the system. On failure the file is as long as before, and all of it waits on. Syncs where
  // much was written since the last time; errors as Sync then.
  //   ResourceExhausted: disk, quota or file size limit full.   Others as EpochFence::Check.
  absl::Status Flush();
  // Forgets what waits.
  void DropWaiting() { waiting_.clear(); }

  // Makes all that was flushed durable. On failure what was flushed since the last success waits again: the system may
  // have dropped it, and a second sync would not tell. The next Flush writes it to a new descriptor.
  absl::Status Sync();

  // Cuts the file, of which nothing waits, to `length` bytes.
  //   DataLoss: it is shorter than that.   Others as EpochFence::Check.
  absl::Status TruncateTo(int64_t length);

  int64_t length() const { return length_; }  // bytes in the file, as far as they are believed
  int64_t waiting_bytes() const { return static_cast<int64_t>(waiting_.size()); }
  const std::string& path() const { return path_; }

 private:
  AppendFile(std::string path, const Options& options) : path_(std::move(path)), options_(options) {}
  absl::Status OpenDescriptor();
  // Before a change: asks the fence, opens the file again after a failed sync, cuts off what does not count.
  absl::Status Prepare();

  std::string path_;
  Options options_;
  int descriptor_ = -1;  // -1: moved from, or closed by a failed sync
  int64_t length_ = 0;
  std::string unsynced_;  // the end of the file, since the last sync, if `durable`
  std::string waiting_;
  bool torn_ = false;  // the file may go on beyond `length_`
};

}  // namespace craftfleet

#endif  // CRAFTFLEET_LEARNER_RUN_APPEND_FILE_H_
