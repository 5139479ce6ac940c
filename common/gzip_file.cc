#include "common/gzip_file.h"

#include <zlib.h>

#include <cerrno>
#include <vector>

#include <absl/strings/str_cat.h>

#include "common/files.h"

namespace craftfleet {

absl::StatusOr<std::string> ReadGzipFile(const std::string& path) {
  const gzFile file = gzopen(path.c_str(), "rb");
  if (file == nullptr) return FileError(errno, "open", path);
  std::string text;
  std::vector<char> buffer(1 << 16);
  int count = 0;
  while ((count = gzread(file, buffer.data(), buffer.size())) > 0) text.append(buffer.data(), count);
  // A file that stops short reads without an error and closes with one.
  const bool read = count == 0;
  if (gzclose(file) != Z_OK || !read) return absl::DataLossError(absl::StrCat(path, ": cut or damaged gzip data"));
  return text;
}

}  // namespace craftfleet
