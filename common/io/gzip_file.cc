#include "common/io/gzip_file.h"

#include <zlib.h>

#include <cerrno>
#include <vector>

#include <absl/strings/str_cat.h>

#include "common/io/files.h"

namespace craftfleet {

absl::StatusOr<std::string> ReadGzipFile(const std::string& path) {
  std::string text;
  const absl::Status status = ReadGzipPieces(path, [&text](absl::string_view piece) {
    absl::StrAppend(&text, piece);
    return absl::OkStatus();
  });
  if (!status.ok()) return status;
  return text;
}

absl::Status ReadGzipPieces(const std::string& path, absl::FunctionRef<absl::Status(absl::string_view piece)> take) {
  const gzFile file = gzopen(path.c_str(), "rb");
  if (file == nullptr) return FileError(errno, "open", path);
  std::vector<char> buffer(1 << 16);
  absl::Status status;
  int count = 0;
  while (status.ok() && (count = gzread(file, buffer.data(), buffer.size())) > 0) {
    status = take(absl::string_view(buffer.data(), count));
  }
  // For a truncated file zlib reports the error only when the file is closed.
  const bool whole = gzclose(file) == Z_OK && count == 0;
  if (status.ok() && !whole) return absl::DataLossError(absl::StrCat(path, ": cut or damaged gzip data"));
  return status;
}

}  // namespace craftfleet
