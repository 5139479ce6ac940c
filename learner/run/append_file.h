// An append-only log that can be truncated to an earlier length. While the disk is full, data is buffered in memory, in
// order; data that a failed sync may have lost is written again. Thread-compatible: one thread at a time.

#pragma once

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
  // Creates `path` if it does not exist; gives it a file of its own if it is a hard link. `fence` is checked before
  // each change of the file and outlives this; null: no check. Errors as FileError (common/io/files.h).
  static absl::StatusOr<AppendFile> Open(const std::string& path, const EpochFence* fence = nullptr);
  AppendFile(AppendFile&& other) noexcept;
  AppendFile& operator=(AppendFile&& other) = delete;
  ~AppendFile();

  // Appends `bytes` to the buffer; Flush writes it.
  void Append(absl::string_view bytes) { waiting_.append(bytes.data(), bytes.size()); }
  // Writes the buffer to the file. On an error the file keeps its length, and the buffer its data. Also calls Sync if
  // much was written since the last one; then errors as Sync.
  //   ResourceExhausted: disk, quota or file size limit reached.   Others as EpochFence::Check.
  absl::Status Flush();

  // Makes all flushed data durable. On an error, data flushed since the last success returns to the buffer: the system
  // may have dropped it, and a second sync would not report that. The next Flush writes it to a new descriptor. Others
  // as EpochFence::Check.
  absl::Status Sync();

  // Truncates the file to `length` bytes. The buffer must be empty.
  //   DataLoss: the file is shorter than that.   Others as EpochFence::Check.
  absl::Status TruncateTo(int64_t length);

  int64_t length() const { return length_; }  // valid bytes in the file
  int64_t waiting_bytes() const { return static_cast<int64_t>(waiting_.size()); }
  const std::string& path() const { return path_; }

 private:
  AppendFile(std::string path, const EpochFence* fence) : path_(std::move(path)), fence_(fence) {}
  absl::Status OpenDescriptor();
  absl::StatusOr<int64_t> FindEnd() const;  // the file's length, in bytes
  absl::Status CheckFence() const;
  // To be called before a change or a sync: checks the fence, reopens the file after a failed sync, cuts off what is
  // not this log's: a torn end, or a line that an earlier start was writing when this one took over. Logs an error if
  // something else has cut, replaced or removed the file, and goes on from the end of the file of that name.
  absl::Status Prepare();
  // Forgets what was written after the first `length` bytes.
  void Shorten(int64_t length);

  std::string path_;
  const EpochFence* fence_;
  int descriptor_ = -1;  // -1: moved from, or closed until Prepare reopens it
  int64_t length_ = 0;
  std::string unsynced_;  // data written since the last sync, 1 MiB at most
  std::string waiting_;
  bool torn_ = false;  // the file may be longer than `length_`
};

}  // namespace craftfleet
