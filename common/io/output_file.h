// The output file that a user names with a flag such as --out or --json.

#pragma once

#include <string>

#include <absl/status/status.h>
#include <absl/status/statusor.h>
#include <absl/strings/string_view.h>

namespace craftfleet {

// Opened before the work, so that a target that can't be written is reported then, and written once after it.
// A regular file is replaced atomically: it holds either the old bytes or the new ones, and a link to it stays a link.
// One that may be written but not replaced, such as a mounted file, is overwritten.
// Anything that accepts a stream of bytes, such as a FIFO, a terminal, /dev/null or /dev/stdout, is written directly.
// Thread-compatible.
class OutputFile {
 public:
  // `flag`, such as "--out", names the target in errors. `path` is not empty; "-" is standard output. Blocks on a FIFO
  // until it has a reader.
  //   InvalidArgument: a folder, a block device or a socket.   Others: why the target can't be created or opened.
  static absl::StatusOr<OutputFile> Open(absl::string_view flag, const std::string& path);
  ~OutputFile();
  OutputFile(OutputFile&& other) noexcept;
  OutputFile& operator=(OutputFile&&) = delete;

  // Writes all of `bytes`; flushes standard output first if that is the target. May be called only once.
  absl::Status Write(absl::string_view bytes);

  // Whether the target is standard output: then messages for people must go to standard error.
  bool is_standard_output() const { return standard_output_; }

 private:
  OutputFile(absl::string_view flag, const std::string& path) : flag_(flag), path_(path) {}
  absl::Status OpenTarget();
  absl::Status TryFile();
  absl::Status Named(const absl::Status& status) const;

  std::string flag_;
  std::string path_;  // without links where it is a regular file
  int stream_ = -1;   // -1: a regular file, which is opened when it is written
  bool standard_output_ = false;
};

}  // namespace craftfleet
